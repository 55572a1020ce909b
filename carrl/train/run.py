"""The Python front door: `carrl.train("fast", seed=3)`, and the run that comes of it or lies in a folder."""

import json
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import Any, Self, TypeVar, get_args

import numpy as np
import torch
import yaml
from torch import Tensor

from carrl.errors import CarrlError, CheckpointError, ConfigError, shown
from carrl.evaluation.asked import PolicyName, check_is_free, check_one_drives
from carrl.evaluation.baselines import random_policy, rule_of
from carrl.evaluation.document import Laps, checked_limits, evaluation_figures
from carrl.evaluation.drive_log import DriveLog
from carrl.evaluation.follow_the_gap import follow_the_gap_of
from carrl.evaluation.line_driver import line_driver_of
from carrl.evaluation.rollout import Policy, TrackEvaluator
from carrl.evaluation.speed_trace import speed_table, traced_drives
from carrl.files import write_whole
from carrl.log.reader import Log
from carrl.task.task import World
from carrl.tracks.circuits import Folder, load_folder
from carrl.tracks.track import Track
from carrl.train.build import build_world, load_greedy_policy
from carrl.train.callbacks import Callback
from carrl.train.composition import composed, quote
from carrl.train.experiment import Config, Experiment, ProgressPrinter, RoadWarner, Summary, as_yaml, own_modules
from carrl.train.files import LOG, SUMMARY, load_config, read_text, seed_folders
from carrl.train.new_folder import locked, make_new
from carrl.train.overrides import check_is_read, is_text, named_overrides, readable_overrides
from carrl.train.plan import checked_seed
from carrl.train.resumption import resume as resumption_of

Array = TypeVar("Array", Tensor, np.ndarray[Any, Any])


class Run:
    """A run that has ended, by its folder.

    Args:
        folder: of a run, or of a run of several seeds.
        trust: modules of one's own whose parts the run may name, as names or files: `("parts", "mine/parts.py")`.

    Raises:
        CarrlError: this is no run's folder, or it names parts of a module that is not trusted.
    """

    def __init__(self, folder: str | Path, trust: Sequence[str] = ()) -> None:
        self.folder = Path(folder)
        self._trust = (trust,) if isinstance(trust, str) else tuple(trust)
        self._folders = seed_folders(self.folder)
        self._configs = [load_config(each, self._trust) for each in self._folders]
        self._has_seeds = self._folders != [self.folder]

    @classmethod
    def load(cls, folder: str | Path, trust: Sequence[str] = ()) -> Self:
        """The run in this folder; `trust` names modules of one's own that it may use."""
        return cls(folder, trust)

    def __repr__(self) -> str:
        """The folder."""
        return f"Run({str(self.folder)!r})"

    @cached_property
    def replicates(self) -> list["Run"]:
        """A run for each of several seeds; the run itself where it has one."""
        return [Run(folder, self._trust) for folder in self._folders] if self._has_seeds else [self]

    @property
    def config(self) -> Config:
        """The resolved configuration, of the first of several seeds."""
        return self._configs[0]

    @property
    def summary(self) -> Summary | list[Summary]:
        """What `summary.json` holds; a list of these where there are several seeds.

        Raises:
            CheckpointError: the run has not come to its end, or the file is damaged.
        """
        summaries = [_read_summary(folder) for folder in self._folders]
        return summaries if self._has_seeds else summaries[0]

    @cached_property
    def world(self) -> World:
        """The tracks, car, sensors and reward of the run."""
        return build_world(self.config)

    @cached_property
    def policy(self) -> "DrivingPolicy":
        """The policy of the run's best network, without exploration: an observation to an action.

        Raises:
            CarrlError: there are several seeds, or there is no such checkpoint.
        """
        if len(self._folders) > 1:
            raise CarrlError(
                f"{self!r} has {len(self._folders)} seeds; take the policy of one: run.replicates[0].policy"
            )
        policy = load_greedy_policy(self._folders[0], "best", self.config, self.world)
        return DrivingPolicy(policy, self.world.observation_size)

    @property
    def log(self) -> Log:
        """The run's log, opened: use it in a `with` statement.

        Raises:
            LogError: there is none, or it is damaged.
        """
        return Log(self._folders[0] / LOG)

    def evaluate(
        self,
        tracks: str | Path | Track | Sequence[str | Path | Track] = (),
        starts: int = 1,
        policy: PolicyName = "greedy",
        checkpoint: str = "best",
        laps: int = 1,
        limits: Mapping[str, float] | None = None,
        speed_trace: str | Path | None = None,
        log: str | Path | None = None,
    ) -> dict[str, Any]:
        """Drives the run's policies, and a hand-written rule beside them, and measures how well they drive.

        Args:
            tracks: names, files, folders of files, or tracks; none for those on which the run was evaluated.
            starts: places on each track, spread evenly from its start line on.
            policy: the run's own, or a baseline in its car.
            checkpoint: which of the run's networks, `best` or `last`.
            laps: driven in a row from each place; of several the last one is measured, a flying lap.
            limits: the least time that the car could take for a flying lap of tracks, by their names, s.
            speed_trace: a file to write each measured lap to, moment by moment, as CSV.
            log: a new file to keep all drives of the policy in, as a log like training's.

        Returns:
            What `carrl evaluate --json` prints.

        Raises:
            CarrlError: a track or a checkpoint cannot be read, a limit is no time or of no track that is driven, a file
                cannot be written, or a log is asked for of several seeds.
        """
        loaded, refused = load_tracks([tracks] if isinstance(tracks, str | Path | Track) else tracks)
        circuits = loaded or list(self.world.circuits.validation)
        limits = checked_limits(limits or {}, circuits)
        count = len(self._folders) if policy == "greedy" else 1  # the others differ in nothing that drives
        chosen = list(zip(self._folders[:count], self._configs, strict=False))
        evaluator = TrackEvaluator(self.world, circuits, starts, laps)
        if log is not None:
            check_one_drives(count)
            check_is_free(log)
        drivers = [self._driver(folder, config, policy, checkpoint, circuits) for folder, config in chosen]
        with self._recorder(log, circuits, starts, policy, checkpoint) as recorder:
            driven = [evaluator.evaluate(each, world, speed_trace is not None, recorder) for world, each in drivers]
        rule = self._laps_of_the_rule(evaluator) if policy != "rule" else None
        if speed_trace is not None:
            names = [f"seed {config['seed']}" if policy == "greedy" else policy for _, config in chosen]
            table = speed_table(traced_drives(names, circuits, driven), self.world.vehicle)
            write_whole(speed_trace, table.encode())
        step_length = self.world.vehicle.step_length
        document: dict[str, Any] = {
            "run": str(self.folder),
            "policy": policy,
            **({"laps": laps} if laps > 1 else {}),
            **evaluation_figures(circuits, driven, rule, step_length, limits),
            **({"refused": refused} if refused else {}),
        }
        if count > 1:
            document["runs"] = [
                {
                    "run": str(folder),
                    "seed": config["seed"],
                    **evaluation_figures(circuits, [own], None, step_length, limits),
                }
                for (folder, config), own in zip(chosen, driven, strict=True)
            ]
        return document

    def _driver(
        self, folder: Path, config: Config, policy: PolicyName, checkpoint: str, tracks: Sequence[Track]
    ) -> tuple[World, Policy]:
        """What drives these tracks, and the world as that sees it."""
        if policy not in get_args(PolicyName):
            raise ConfigError(f"policy is {shown(policy)}; it must be {', '.join(get_args(PolicyName))}")
        if policy == "rule":
            return rule_of(self.world)
        if policy == "follow_the_gap":
            return follow_the_gap_of(self.world)
        if policy == "line":
            return line_driver_of(self.world, tracks)
        if policy == "random":
            return self.world, random_policy(checked_seed(config["seed"]), self.world.action)
        return self.world, load_greedy_policy(folder, checkpoint, config, self.world)

    def _recorder(
        self, log: str | Path | None, tracks: Sequence[Track], starts: int, policy: str, checkpoint: str
    ) -> AbstractContextManager[DriveLog | None]:
        """What keeps the drives of the policy, if anything does."""
        if log is None:
            return nullcontext()
        entries = (
            {"policy": policy, "run_folder": str(self.folder.resolve())} if self.folder.name else {"policy": policy}
        )
        entries |= {"checkpoint": checkpoint} if policy == "greedy" else {}
        seed = checked_seed(self.config["seed"])
        return DriveLog(Path(log), as_yaml(self.config), tracks, len(tracks) * starts, seed, entries)

    def _laps_of_the_rule(self, evaluator: TrackEvaluator) -> Laps | None:
        """None of a car that the rule cannot drive."""
        try:
            world, policy = rule_of(self.world)
        except ConfigError:
            return None
        return evaluator.evaluate(policy, world)


@dataclass(frozen=True)
class DrivingPolicy:
    """Actions for observations, as tensors or as arrays, of one car or of many.

    Attributes:
        of_many: observations [B, O] to actions [B, ...].
        size: values of an observation, O.
    """

    of_many: Policy
    size: int

    def __call__(self, observation: Array) -> Array:
        """The action for an observation [O], or the actions for many [B, O], on the CPU, of the same kind of array.

        Raises:
            ConfigError: it has another size.
        """
        try:
            given = torch.as_tensor(observation, dtype=torch.float32)
        except (TypeError, ValueError, RuntimeError) as error:
            raise ConfigError(f"an observation is numbers, not {shown(observation)}") from error
        if given.dim() not in (1, 2) or given.shape[-1] != self.size:
            raise ConfigError(f"an observation has {self.size} values, not the shape {list(given.shape)}")
        with torch.no_grad():
            actions = self.of_many(given if given.dim() > 1 else given[None])
        actions = actions if given.dim() > 1 else actions[0]
        return actions if isinstance(observation, Tensor) else actions.numpy()[()]


def load_tracks(names: Sequence[str | Path | Track]) -> tuple[list[Track], dict[str, str]]:
    """The tracks of these names, files and folders; and why files of a folder were left out."""
    tracks: list[Track] = []
    refused: dict[str, str] = {}
    for name in names:
        if isinstance(name, Track):
            tracks.append(name)
            continue
        found = load_folder(Path(name)) if Path(name).is_dir() else Folder([Track.load(name)], {})
        tracks += found.tracks
        refused |= {str(path): reason for path, reason in found.refused.items()}
    return tracks, refused


def _read_summary(folder: Path) -> Summary:
    try:
        summary: Summary = json.loads(read_text(folder / SUMMARY))
    except ValueError as error:
        raise CheckpointError(f"'{folder / SUMMARY}' is damaged: {error}") from error
    return summary


def train(
    experiment: str | None = None,
    *,
    overrides: Mapping[str, Any] | Sequence[str] = (),
    folder: str | Path | None = None,
    resume: str | Path | None = None,
    config_dir: str | Path | None = None,
    trust: Sequence[str] = (),
    callbacks: Sequence[Callback] = (),
    progress: bool = False,
    **values: Any,
) -> Run:
    """Trains as `carrl train` does: `carrl.train("fast", seed=3, loss="double_dqn")`.

    Args:
        experiment: a named experiment of `conf/experiment`; None for the paper's run.
        overrides: what keywords cannot say, `{"trainer.frames": 20_000}` or `["trainer.frames=20000"]`.
        folder: for the results; None for a new one in `outputs/`.
        resume: the folder of a run to go on with instead of beginning one.
        config_dir: a folder of groups and experiments of your own, beside which your modules may lie.
        trust: modules of your own that a run to be resumed may use.
        callbacks: follow the training.
        progress: print how it goes on standard error.
        **values: of the configuration, by their keys; a mapping stands for the keys below.

    Raises:
        CarrlError: the configuration cannot be, or something ended the training before its time.
    """
    if config_dir is not None and not Path(config_dir).is_dir():
        raise ConfigError(f"config_dir is '{config_dir}', which is no folder")
    overrides = [overrides] if isinstance(overrides, str) else overrides
    typed = [*_typed({**({"experiment": experiment} if experiment else {}), **values})]
    typed += _typed(overrides) if isinstance(overrides, Mapping) else overrides
    if not all(isinstance(each, Callback) for each in callbacks):
        raise ConfigError(
            f"callbacks is {shown(list(callbacks))}; it must list objects of carrl.train.callbacks.Callback"
        )
    watching = [RoadWarner(), *([ProgressPrinter()] if progress else []), *callbacks]
    if resume is not None:
        if folder is not None or config_dir is not None:
            raise ConfigError("folder and config_dir have no effect where a run is resumed; leave them out")
        return _resume(Path(resume), typed, trust, watching)
    if trust:
        raise ConfigError("trust has no effect without resume; what you name yourself is trusted")
    readable = readable_overrides(typed, is_sweep=None, verb="carrl.train", folder_key="folder=")
    config = composed(readable, None if config_dir is None else Path(config_dir))
    check_is_read(readable, config)
    path = make_new(Path(f"outputs/{datetime.now():%Y-%m-%d/%H-%M-%S}")) if folder is None else Path(folder)
    try:
        Experiment(config, path, {"overrides.yaml": yaml.safe_dump(readable)}).run(watching)
    except CarrlError:
        with suppress(OSError):  # it is not empty, but for a run that was refused
            path.rmdir()
        raise
    return Run(path, own_modules(config))


def _resume(run: Path, typed: Sequence[str], trust: Sequence[str], callbacks: Sequence[Callback]) -> Run:
    load_config(run, trust)  # so that nothing is written to a folder that is no run's
    with locked(run):
        resumption = resumption_of(run, named_overrides(typed), trust)
        for remark in resumption.remarks:
            warnings.warn(remark, stacklevel=3)
        Experiment(resumption.config, run).go_on(resumption.state, callbacks)
    return Run(run, trust)


def _typed(values: Mapping[str, Any], above: str = "") -> Iterator[str]:
    """The overrides that set these values."""
    for key, value in values.items():
        if isinstance(value, Mapping) and value:
            yield from _typed(value, f"{above}{key}.")
        else:
            yield f"{above}{key}={_as_typed(value)}"


def _as_typed(value: Any) -> str:
    """A value as it stands behind the equals sign of an override.

    Raises:
        ConfigError: it is no plain value.
    """
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, str | Path):
        return str(value) if is_text(f"key={value}") else quote(str(value))
    if isinstance(value, list | tuple | range):
        return f"[{','.join(map(_as_typed, value))}]"
    if value is None or isinstance(value, bool):
        return json.dumps(value)
    if isinstance(value, int | float):
        return str(value)
    if value == {}:
        return "{}"
    raise ConfigError(f"{value!r} is no value of a configuration; give a number, text, list or mapping")
