"""`carrl tune`: searches for the settings that do best, and gives up hopeless trials early.

What it searches is the configuration's `search`; a trial draws overrides from it.
"""

import argparse
import json
import math
import os
import re
import shlex
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from carrl.cli.parser import Parser, named_folder
from carrl.errors import CarrlError, ConfigError, shown
from carrl.train.objectives import OBJECTIVES

if TYPE_CHECKING:
    from carrl.cli.text.many_runs import TrialRow
    from carrl.cli.trials import Tuning

SEARCH = "search"
"""The key of the configuration; training does not read it."""
STUDY = "study.db"
WARM_UP_TRIALS, WARM_UP_EVALUATIONS = 4, 2
"""Before these no trial is given up: by then the median means something."""
_ASKED = "asked"


@dataclass(frozen=True)
class Range:
    """Numbers from `low` to `high`, both included.

    Attributes:
        log: draw their logarithms evenly, for what matters by factors.
    """

    low: int | float
    high: int | float
    log: bool = False

    def suggest(self, trial: Any, key: str) -> str:
        """The trial's value, as typed; a whole number where both ends are."""
        suggest = trial.suggest_int if isinstance(self.low, int) and isinstance(self.high, int) else trial.suggest_float
        return str(suggest(key, self.low, self.high, log=self.log))


@dataclass(frozen=True)
class Choice:
    """One of these values, as typed: options of a group, numbers, or lists such as [64,32]."""

    values: tuple[str, ...]

    def suggest(self, trial: Any, key: str) -> str:
        """The trial's value."""
        value: str = trial.suggest_categorical(key, self.values)
        return value


SearchSpace = Mapping[str, Range | Choice]


def parse_search_space(node: Any) -> SearchSpace:
    """The search space of a configuration's `search`.

    Raises:
        ConfigError: it is empty, or an entry is neither a range nor a choice.
    """
    if not isinstance(node, Mapping) or not node:
        raise ConfigError(
            f"the configuration has no {SEARCH}; choose one that has, as in carrl tune experiment=tune, "
            f"or write one, as conf/experiment/tune.yaml does"
        )
    return {str(key): _parse(f"{SEARCH}.{key}", entry) for key, entry in node.items()}


def _parse(name: str, entry: Any) -> Range | Choice:
    keys = set(entry) if isinstance(entry, Mapping) else set()
    if keys == {"choices"} and isinstance(entry["choices"], list) and entry["choices"]:
        return Choice(tuple(_typed(value) for value in entry["choices"]))
    if {"low", "high"} <= keys <= {"low", "high", "log"}:
        low, high, log = entry["low"], entry["high"], entry.get("log", False)
        numbers = all(isinstance(end, int | float) and not isinstance(end, bool) for end in (low, high))
        if numbers and isinstance(log, bool) and low < high and not (log and low <= 0):
            return Range(low, high, log)
    raise ConfigError(
        f"{name} is {shown(entry)}; it must be choices: [...] or low: and high:, numbers with low < high, "
        "and, if you like, log: true, for which low must be positive"
    )


def _typed(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value, separators=(",", ":"))


def main(argv: list[str]) -> int:
    """Runs trials, prints them as a table, and the command that trains with the best settings."""
    arguments = _parser().parse_intermixed_args(argv)
    if find_spec("optuna") is None:
        raise ConfigError("carrl tune needs optuna; pip install 'carrl[tune]'")
    if arguments.trials < 1:
        raise ConfigError(f"--trials is {arguments.trials}; it must be at least 1")
    if arguments.timeout is not None and not 0 < arguments.timeout < math.inf:
        raise ConfigError(f"--timeout is {arguments.timeout}; it must be a positive number of seconds")
    from carrl.train.composition import composed  # brings Hydra
    from carrl.train.new_folder import locked, make_new
    from carrl.train.overrides import readable_overrides

    overrides = readable_overrides(arguments.overrides, is_sweep=None)
    config = composed(overrides, arguments.config_dir)
    if config.get("data"):
        raise ConfigError("data is given, but only training in the simulator can be tuned; leave data=log out")
    space = parse_search_space(config.get(SEARCH))
    _check_is_free(overrides, space)
    folder = arguments.folder or make_new(Path(f"outputs/tune/{datetime.now():%Y-%m-%d/%H-%M-%S}"))
    _make_writable(folder)
    if "torch" not in sys.modules:  # else nothing keeps one waiting
        print(f"tuning in {folder}; each trial is a training run", file=sys.stderr, flush=True)
    from carrl.cli.text.many_runs import TuningConsole
    from carrl.cli.trials import Tuning  # From here on it takes seconds.

    tuning = Tuning(overrides, space, OBJECTIVES[arguments.objective], folder, arguments.config_dir)
    with locked(folder, waiting=True):  # several commands may share a study, but only one may make it
        study = _open_study(arguments, tuning, config["seed"])
    console = TuningConsole(arguments.trials, tuple(space), maximizes=tuning.objective.direction == "maximize")
    deadline = time.monotonic() + arguments.timeout if arguments.timeout else None
    try:
        while len(done := _rows(study)) < arguments.trials and (deadline is None or time.monotonic() < deadline):
            console.show_rest(done)
            tuning.run_trial(study)
            console.show(_rows(study))
    except KeyboardInterrupt:
        print(f"interrupted; go on with the same command and --folder {folder}")
        raise
    finally:
        console.print_results(_rows(study))
    _print_best(study, tuning)
    return 0


def _check_is_free(overrides: Sequence[str], space: SearchSpace) -> None:
    """Raises ConfigError for a typed setting that every trial would draw anew."""
    for override in overrides:
        key = override.partition("=")[0].lstrip("+~")
        if key in space:
            raise ConfigError(f"{override} has no effect, as {SEARCH} has {key}, which each trial draws; leave one out")


def _make_writable(folder: Path) -> None:
    """Makes the study's folder.

    Raises:
        ConfigError: it cannot be made or written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"--folder '{folder}' cannot be made: {error.strerror}; choose another") from error
    if not os.access(folder, os.W_OK):
        raise ConfigError(f"--folder '{folder}' cannot be written to; choose another")


def _open_study(arguments: argparse.Namespace, tuning: "Tuning", seed: int) -> Any:
    """The study in the storage, new or to go on with.

    Raises:
        ConfigError: the storage cannot be used, or has a study of something else, or the folder has another's trials.
    """
    import optuna

    from carrl.train.new_folder import check_holds_no_run

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    storage = arguments.storage or f"sqlite:///{tuning.folder.absolute()}/{STUDY}"
    pruner = optuna.pruners.MedianPruner(WARM_UP_TRIALS, WARM_UP_EVALUATIONS)
    try:
        study = optuna.create_study(
            storage=storage,
            study_name="carrl",
            direction=tuning.objective.direction,
            pruner=optuna.pruners.NopPruner() if arguments.no_pruning else pruner,
            load_if_exists=True,
        )
    except Exception as error:  # of SQLAlchemy and its drivers
        raise ConfigError(f"--storage '{storage}' cannot be used: {str(error).splitlines()[0]}") from error
    if not study.trials:
        for folder in tuning.folder.glob("trial=*"):
            check_holds_no_run(folder)
    study.sampler = optuna.samplers.TPESampler(seed=(seed + len(study.trials)) % 2**32)
    asked = [*tuning.overrides, f"--objective {arguments.objective}", *map(str, tuning.space.items())]
    if study.user_attrs.get(_ASKED, asked) != asked:
        raise ConfigError(f"'{storage}' has a study of something else; give another --folder or --storage")
    study.set_user_attr(_ASKED, asked)
    return study


def _rows(study: Any) -> list["TrialRow"]:
    """The trials that came to an end of their own."""
    from carrl.cli.text.many_runs import TrialRow
    from carrl.cli.trials import ERROR

    ends = {"COMPLETE": "complete", "PRUNED": "given up", "FAIL": "failed"}
    return [
        TrialRow(
            trial.number,
            ends[trial.state.name],
            trial.value if trial.state.name == "COMPLETE" else None,
            {key: str(value) for key, value in trial.params.items()},
            (trial.duration.total_seconds() if trial.duration else 0.0),
            trial.user_attrs.get(ERROR),
        )
        for trial in study.get_trials(deepcopy=False)
        if trial.state.name in ("COMPLETE", "PRUNED") or ERROR in trial.user_attrs
    ]


def _print_best(study: Any, tuning: "Tuning") -> None:
    complete = [row for row in _rows(study) if row.value is not None]
    if not complete:
        raise CarrlError("no trial was completed; allow more --trials or a longer --timeout")
    best = study.best_trial
    drawn = [f"{key}={value}" for key, value in best.params.items()]
    command = f"carrl train {shlex.join([*_read_by_training(tuning.overrides, tuning.own_folder), *drawn])}"
    print(f"trial {best.number} is the best; train with its settings:\n\n  {command}")
    print(f"\nresults in {tuning.folder.absolute()}; compare its trials: carrl report {tuning.folder}")


def _read_by_training(overrides: Sequence[str], own_folder: Path | None = None) -> list[str]:
    """What of a study's command line `carrl train` reads, too: neither its search nor a seed of its own alone."""
    from carrl.train.composition import composed
    from carrl.train.overrides import is_search

    has_seeds = composed(overrides, own_folder)["trainer"].get("seeds") is not None
    own = [] if own_folder is None else ["--config-dir", str(own_folder)]
    settings = [each for each in overrides if not (is_search(each) or (has_seeds and re.match(r"\+*seed=", each)))]
    return [*own, *settings]


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="carrl tune",
        description="Searches for the settings that do best, with Optuna. The configuration's key search says among "
        "which; conf/experiment/tune.yaml is an example.",
    )
    parser.add_argument("overrides", nargs="*", metavar="OVERRIDE", help="as for carrl train: experiment=tune seed=1")
    parser.add_argument("--trials", type=int, default=20, metavar="N", help="of the study in all (default: 20)")
    parser.add_argument("--timeout", type=float, metavar="S", help="begin no further trial after so many seconds")
    parser.add_argument(
        "--objective",
        choices=OBJECTIVES,
        default="first_lap",
        help="first_lap: env steps until the greedy policy first laps, and again at the next evaluation (default); "
        "drive: how well it drives at its best; lap_time: mean lap time at its best, s",
    )
    parser.add_argument("--no-pruning", action="store_true", help="give up no trial before its end")
    parser.add_argument(
        "--folder", type=named_folder, help="of the study, to go on with it (default: outputs/tune/DATE/TIME)"
    )
    parser.add_argument(
        "--config-dir",
        type=named_folder,
        metavar="FOLDER",
        help="of your own groups, as for carrl train",
    )
    parser.add_argument("--storage", metavar="URL", help=f"of the study (default: sqlite:///FOLDER/{STUDY})")
    return parser
