"""`carrl train`: trains a policy and leaves its run's folder, or goes on with one.

What trains is imported once the configuration is composed, so that a misspelt key is answered at once.
"""

import os
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from carrl.cli.sweep import FLAGS, Refusal, config_folders, hydra_records, sweep
from carrl.config import config_dir
from carrl.errors import CarrlError, ConfigError, printable, shown
from carrl.train.composition import explain, plain
from carrl.train.files import load_config
from carrl.train.new_folder import check_holds_no_run, locked
from carrl.train.overrides import (
    TRUST,
    Arguments,
    check_is_read,
    named_overrides,
    readable_overrides,
    sort_arguments,
    unquote,
)
from carrl.train.plan import check_early

RESUME = "resume="


def main(argv: list[str]) -> int:
    """Runs Hydra on the overrides, for one run or, with -m, for many; with `resume=RUN` it goes on with that run."""
    typed = sort_arguments(argv)
    if "--help" in typed.flags:
        from carrl.cli.text.train_help import print_help

        print_help()
        return 0
    run = _resumed_run(typed.overrides)
    if run is not None:
        return _resume(run, typed)
    if any(flag.startswith(f"{TRUST}=") for flag in typed.flags):
        raise ConfigError(f"{TRUST} has no effect without {RESUME}RUN: what is typed is trusted; leave it out")
    is_sweep = any(flag in FLAGS for flag in (*typed.flags, *typed.overrides))
    overrides = readable_overrides(typed.overrides, is_sweep)
    arguments = [*typed.flags, *overrides]
    if is_sweep:
        return sweep(arguments, _run_hydra)
    failures: list[CarrlError] = []

    def job(config: DictConfig) -> None:
        path = Path(HydraConfig.get().runtime.output_dir)
        try:
            values = plain(config, config_folders())
            check_is_read(overrides, values)
            check_early(values)
            with locked(path):  # who works there is named first
                check_holds_no_run(path)
            _say(f"training {_in_short(values)}, in {path}")
            from carrl.cli.text.console import follow_run, print_results
            from carrl.train.experiment import Experiment

            summaries = Experiment(values, path, hydra_records()).run(follow_run())
            print_results(values, summaries, path)
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
    flags = [flag for flag in typed.flags if not flag.startswith(f"{TRUST}=")]
    if flags:
        raise ConfigError(f"{flags[0]} cannot be given with {RESUME}; one run is resumed at a time")
    trust = [flag.partition("=")[2] for flag in typed.flags]
    changes = [override for override in typed.overrides if not _is_resume(override)]
    config = load_config(run, trust)  # so that nothing is written to a folder that is no run's
    _say(f"going on with {_in_short(config)}, in {run}")
    from carrl.cli.text.console import follow_run, print_results
    from carrl.train.experiment import Experiment
    from carrl.train.resumption import resume

    with locked(run):
        resumption = resume(run, named_overrides(changes), trust)
        for remark in resumption.remarks:
            print(printable(remark))
        experiment = Experiment(resumption.config, run)
        summaries = experiment.go_on(resumption.state, follow_run())
    print_results(resumption.config, summaries, run)
    return 0


def _in_short(config: Mapping[str, Any]) -> str:
    """What is trained, in a few words."""
    seeds = config["trainer"].get("seeds")
    who = f"seed {config['seed']}" if seeds is None else f"seeds {shown(seeds)}"
    track = config["track"]
    name = track.get("name_or_path") or f"{track.get('_target_', '').rpartition('.')[2]} tracks"
    return f"{who} on track {name}" if not config.get("data") else f"{who} on logs"


def _say(sentence: str) -> None:
    """Prints the first line where torch is yet to be imported, which takes seconds in which nothing else is seen."""
    if sys.modules.get("torch") is None:
        print(printable(sentence), file=sys.stderr, flush=True)
