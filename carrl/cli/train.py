"""`carrl train`: trains a policy and leaves its run's folder, or goes on with one.

What trains is imported once the configuration is composed, so that a misspelt key is answered at once.
"""

import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from carrl.cli.known_keys import explain
from carrl.cli.overrides import Arguments, named_overrides, readable_overrides, sort_arguments, unquote
from carrl.cli.plain import plain
from carrl.cli.sweep import FLAGS, sweep
from carrl.config import config_dir
from carrl.errors import CarrlError, ConfigError

RESUME = "resume="
HYDRAS_OWN = {".hydra", ".hydra/config.yaml", ".hydra/hydra.yaml", ".hydra/overrides.yaml"}
"""What Hydra writes before anything is checked."""


def main(argv: list[str]) -> int:
    """Runs Hydra on the overrides, for one run or, with -m, for many; with `resume=RUN` it goes on with that run."""
    typed = sort_arguments(argv)
    run = _resumed_run(typed.overrides)
    if run is not None:
        return _resume(run, typed)
    is_sweep = any(flag in FLAGS for flag in (*typed.flags, *typed.overrides))
    arguments = [*typed.flags, *readable_overrides(typed.overrides, is_sweep)]
    if is_sweep:
        return sweep(arguments, _run_hydra)
    failures: list[CarrlError] = []

    def job(config: DictConfig) -> None:
        path = Path(HydraConfig.get().runtime.output_dir)
        try:
            values = plain(config)
            from carrl.cli.training import train

            train(values, path)
        except CarrlError as error:  # kept from Hydra, which would print it in its own way
            failures.append(error)
            _remove_unless_begun(path)

    _run_hydra(arguments, job)
    if failures:
        raise failures[0]
    return 0


def _resumed_run(overrides: Sequence[str]) -> Path | None:
    """The run that is to be gone on with, if any.

    Raises:
        ConfigError: there are several.
    """
    values = [unquote(override.lstrip("+").removeprefix(RESUME)) for override in overrides if _is_resume(override)]
    runs = [value for value in values if value not in ("", "null")]
    if len(runs) > 1:
        raise ConfigError(f"{RESUME} is given {len(runs)} times; one run is resumed at a time")
    return Path(runs[0]) if runs else None


def _is_resume(override: str) -> bool:
    return override.lstrip("+").startswith(RESUME)


def _run_hydra(arguments: Sequence[str], job: Callable[[DictConfig], None]) -> None:
    """Runs Hydra, which composes the configuration and calls the job.

    Raises:
        CarrlError: the configuration cannot be composed, or the run's folder not be written.
    """
    os.environ["HYDRA_FULL_ERROR"] = "1"  # errors come here instead of Hydra's own printer, which exits with 1
    sys.argv = ["carrl train", *arguments]
    try:
        hydra.main(version_base="1.3", config_path=str(config_dir()), config_name="train")(job)()
    except (HydraException, OmegaConfBaseException) as error:
        launcher = "hydra/launcher" in str(error) and any("hydra/launcher=" in argument for argument in arguments)
        remedy = "; joblib and submitit need pip install 'carrl[sweep]'" if launcher else ""
        raise ConfigError(explain(error) + remedy) from error
    except OSError as error:
        raise CarrlError(f"the run's folder '{error.filename}' cannot be written: {error.strerror}") from error


def _resume(run: Path, typed: Arguments) -> int:
    if typed.flags:
        raise ConfigError(f"{typed.flags[0]} cannot be given with {RESUME}; one run is resumed at a time")
    from carrl.cli.training import train
    from carrl.run.resumption import resumed_config, resumed_state

    changes = [override for override in typed.overrides if not _is_resume(override)]
    config = resumed_config(run, named_overrides(changes))
    train(config, run, resumed_state(run, config))
    return 0


def _remove_unless_begun(path: Path) -> None:
    """Leaves nothing behind of a run that was refused before it began."""
    found = {each.relative_to(path).as_posix() for each in path.rglob("*")}
    if found <= HYDRAS_OWN:
        for name in sorted(found, reverse=True):
            (path / name).rmdir() if (path / name).is_dir() else (path / name).unlink()
        path.rmdir()
