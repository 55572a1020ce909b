"""`carrl train`: trains a policy and leaves its run's folder, or goes on with one.

What trains is imported once the configuration is composed, so that a misspelt key is answered at once.
"""

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from carrl.cli.known_keys import explain
from carrl.cli.overrides import Arguments, check_is_read, named_overrides, readable_overrides, sort_arguments, unquote
from carrl.cli.plain import plain
from carrl.cli.records import HYDRA, OVERRIDES, write_records
from carrl.cli.sweep import FLAGS, sweep
from carrl.cli.sweep_hooks import Refusal
from carrl.config import config_dir
from carrl.errors import CarrlError, ConfigError
from carrl.printable import printable
from carrl.train.files import CONFIG, load_config
from carrl.train.lock import LOCK, locked
from carrl.train.new_folder import check_holds_no_run

RESUME = "resume="
_BEFORE_TRAINING = {".hydra", str(CONFIG), str(HYDRA), str(OVERRIDES), LOCK}
"""What is written before everything is checked."""


def main(argv: list[str]) -> int:
    """Runs Hydra on the overrides, for one run or, with -m, for many; with `resume=RUN` it goes on with that run."""
    typed = sort_arguments(argv)
    run = _resumed_run(typed.overrides)
    if run is not None:
        return _resume(run, typed)
    is_sweep = any(flag in FLAGS for flag in (*typed.flags, *typed.overrides))
    overrides = readable_overrides(typed.overrides, is_sweep)
    arguments = [*typed.flags, *overrides]
    if is_sweep:
        return sweep(arguments, _run_hydra)
    failures: list[CarrlError] = []

    def job(config: DictConfig) -> None:
        path = Path(HydraConfig.get().runtime.output_dir)
        try:
            values = plain(config)
            check_is_read(overrides, values)
            from carrl.cli.training import train

            with locked(path):
                check_holds_no_run(path)
                with _leaving_nothing_if_refused(path):
                    write_records(path)
                    train(values, path)
        except CarrlError as error:  # kept from Hydra, which would print it in its own way
            failures.append(error)
            with suppress(OSError):  # it is not empty, but for a run that was refused
                path.rmdir()

    _run_hydra(arguments, job)
    if failures:
        raise failures[0]
    return 0


def _resumed_run(overrides: Sequence[str]) -> Path | None:
    """The run that is to be gone on with, if any.

    Raises:
        ConfigError: there are several, or none is named.
    """
    values = [unquote(override.lstrip("+").removeprefix(RESUME)) for override in overrides if _is_resume(override)]
    if "" in values:
        raise ConfigError(f"{RESUME} lacks its value; write {RESUME}RUN, with the folder of a run")
    runs = [value for value in values if value != "null"]
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
    except Refusal as refusal:
        raise refusal.error from None
    except (HydraException, OmegaConfBaseException, YAMLError) as error:
        launcher = "hydra/launcher" in str(error) and any("hydra/launcher=" in argument for argument in arguments)
        remedy = "; joblib and submitit need pip install 'carrl[sweep]'" if launcher else ""
        raise ConfigError(explain(error) + remedy) from error
    except OSError as error:
        raise CarrlError(f"the run's folder '{error.filename}' cannot be written: {error.strerror}") from error


def _resume(run: Path, typed: Arguments) -> int:
    if typed.flags:
        raise ConfigError(f"{typed.flags[0]} cannot be given with {RESUME}; one run is resumed at a time")
    from carrl.cli.training import train
    from carrl.train.resumption import resume

    changes = [override for override in typed.overrides if not _is_resume(override)]
    load_config(run)  # so that nothing is written to a folder that is no run's
    with locked(run):
        resumption = resume(run, named_overrides(changes))
        for remark in resumption.remarks:
            print(printable(remark))
        train(resumption.config, run, resumption.state)
    return 0


@contextmanager
def _leaving_nothing_if_refused(path: Path) -> Iterator[None]:
    """Removes the records of a run that was refused before it began."""
    try:
        yield
    except CarrlError:
        found = {each.relative_to(path).as_posix() for each in path.rglob("*")}
        if found <= _BEFORE_TRAINING:
            for name in sorted(found - {LOCK}, reverse=True):
                (path / name).rmdir() if (path / name).is_dir() else (path / name).unlink()
        raise
