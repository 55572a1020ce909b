"""One training run, from its configuration to its pictures: what `carrl train`, `carrl tune` and Python go through."""

import sys
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
import yaml
from torchrl import logger as torchrl_logger

from carrl.config import build_node, foreign_targets, module_of, name_for_trust
from carrl.data.description import attachments, describe_run, log_schema
from carrl.errors import CarrlError, CheckpointError
from carrl.evaluation.results import Rollout
from carrl.log.writer import LogWriter
from carrl.sim.drivability import Car, unsuitable
from carrl.sim.vehicle import Rectangle
from carrl.task.task import World
from carrl.tracks.centreline import gap_of
from carrl.tracks.track import Track
from carrl.train.build import Pipeline, build_pipeline, logs_of
from carrl.train.callbacks import Callback
from carrl.train.checkpoint import StateFile
from carrl.train.files import CONFIG, LAP, LEARNING_CURVE, LOG, Inputs, check_inputs, checksums, write_text
from carrl.train.folder import RunFolder, check_tables
from carrl.train.new_folder import LOCK, check_holds_no_run, locked
from carrl.train.plan import checked_threads
from carrl.train.replicate_run import ReplicateRun
from carrl.train.scalars import Scalars
from carrl.train.trainer import Trainer
from carrl.train.trials import read_trials

Config = dict[str, Any]
Summary = dict[str, Any]
"""What `summary.json` holds."""


@dataclass(frozen=True)
class Experiment:
    """A training run.

    Attributes:
        config: resolved, as plain values.
        folder: where the results go.
        records: further files beside the configuration, by name, that say how the run was asked for.
    """

    config: Config
    folder: Path
    records: Mapping[str, str] = field(default_factory=dict)

    def run(self, callbacks: Sequence[Callback] = ()) -> list[Summary]:
        """Trains in a folder that holds no run yet; returns each replicate's summary.

        Raises:
            CarrlError: whatever ended the run before its time; one that did not begin leaves nothing behind.
        """
        with locked(self.folder):
            check_holds_no_run(self.folder)
            with self._leaving_nothing_if_refused():
                return self.go_on(None, callbacks)

    def go_on(self, state: dict[str, Any] | None, callbacks: Sequence[Callback] = ()) -> list[Summary]:
        """Goes on with a run, whose folder must be locked, from its latest state; None if it has none yet.

        A run that was stopped early says so in its summaries, whose `finished` is false.

        Raises:
            CarrlError: whatever ended the run before its time.
        """
        torchrl_logger.setLevel("WARNING")
        torch.set_num_threads(checked_threads(self.config["threads"]))
        with _naming_exhaustion(), ExitStack() as stack:
            try:
                trainer = self._prepare(state, stack)
            except KeyError as error:  # of the log's own part of the state
                if state is None:
                    raise
                raise CheckpointError(
                    f"run '{self.folder}': the state does not fit the run's configuration: {error}"
                ) from error
            if state is not None:
                trainer.load_state_dict(state)
            _train(trainer, callbacks)
            summaries = self._write_summaries(trainer)
        if not trainer.stopping:
            _draw(trainer)
        return summaries

    @contextmanager
    def _leaving_nothing_if_refused(self) -> Iterator[None]:
        """Removes the records of a run that was refused before it began."""
        try:
            yield
        except CarrlError:
            records = {CONFIG.parent, CONFIG, *(CONFIG.with_name(name) for name in self.records)}
            found = {path.relative_to(self.folder) for path in self.folder.rglob("*")} - {Path(LOCK)}
            if found <= records:
                for path in sorted(found, reverse=True):
                    (self.folder / path).rmdir() if path == CONFIG.parent else (self.folder / path).unlink()
            raise

    def _prepare(self, state: Mapping[str, Any] | None, stack: ExitStack) -> Trainer:
        """The training, its folders opened."""
        pipeline = build_pipeline(self.config)
        inputs = checksums(pipeline.world.circuits, logs_of(self.config), pipeline.world.opponents_files)
        self._check_is_as_left(pipeline, inputs, state)
        _write(self.folder / CONFIG, as_yaml(self.config))
        for name, text in self.records.items():
            _write(self.folder / CONFIG.with_name(name), text)
        folders = []
        state_file = StateFile(self.folder, self.config, pipeline.plan.checkpoint_interval, inputs)
        for index, seed in enumerate(pipeline.algorithm.seeds):
            path, config = self._replicate(seed)
            own_state, scalars = state["folders"][index] if state else None, _open_scalars(path, config)
            log = _open_log(path, config, pipeline, seed, own_state, state_file)
            if log is not None:
                stack.enter_context(log)  # which completes it where the folder is refused
            folders.append(stack.enter_context(RunFolder(path, log, own_state, scalars)))
        return Trainer(pipeline, folders, state_file)

    def _check_is_as_left(self, pipeline: Pipeline, inputs: Inputs, state: Mapping[str, Any] | None) -> None:
        """Refuses, before anything is written, what is not as the state's run had it."""
        if state is None:
            return
        check_inputs(self.folder, state["inputs"], inputs)
        seeds = pipeline.algorithm.seeds
        if len(state["folders"]) != len(seeds):
            raise CheckpointError(
                f"run '{self.folder}': the state does not fit the run's configuration: it has other seeds"
            )
        for seed, own in zip(seeds, state["folders"], strict=True):
            check_tables(self._folder_of(seed), own)

    def _folder_of(self, seed: int) -> Path:
        """Where a replicate leaves its results: the run's own folder, or one below it where there are several."""
        return self.folder if self.config["trainer"].get("seeds") is None else self.folder / f"seed={seed}"

    def _replicate(self, seed: int) -> tuple[Path, Config]:
        """A replicate's folder, and its configuration as if trained alone."""
        path = self._folder_of(seed)
        if path == self.folder:
            return path, self.config
        config = {**self.config, "seed": seed, "trainer": {**self.config["trainer"], "seeds": None}}
        _write(path / CONFIG, as_yaml(config))
        return path, config

    def _write_summaries(self, trainer: Trainer) -> list[Summary]:
        own = [name_for_trust(module) for module in own_modules(self.config)]
        summaries = [{**summary, **({"trust": own} if own else {})} for summary in trainer.summaries()]
        for run, summary in zip(trainer.runs, summaries, strict=True):
            run.folder.write_summary(summary)
        return summaries


def own_modules(config: Config) -> list[str]:
    """The modules, other than CarRL's, whose parts a run is made of, and which must be trusted to open it again."""
    return sorted({module_of(str(target)) for target in foreign_targets(config).values()})


class RoadWarner(Callback):
    """Warns of a track that does not suit the car."""

    def on_start(self, trainer: Trainer) -> None:
        """Warns, if there is a reason to."""
        world = trainer.pipeline.world
        if (warning := road_warning(world.circuits.all, world)) is not None:
            warnings.warn(warning.removeprefix("warning: "), stacklevel=2)


class ProgressPrinter(Callback):
    """Prints a line on standard error every few seconds."""

    _INTERVAL_S = 2.0
    _printed_at = 0.0

    def on_round(self, trainer: Trainer) -> None:
        """Prints how far the training is."""
        if time.monotonic() < self._printed_at + self._INTERVAL_S:
            return
        self._printed_at = time.monotonic()
        loss = sum(run.status.loss for run in trainer.runs) / len(trainer.runs)
        done = f"{trainer.frames:,} env steps, {trainer.updates:,} updates, loss {loss:.4g}"
        print(f"{min(trainer.share_done, 1):.0%}: {done}", file=sys.stderr)


def road_warning(tracks: Sequence[Track], world: World) -> str | None:
    """One sentence if any of the tracks does not suit the car, with what is wrong of the first."""
    threshold = world.reward.near_wall.threshold if world.reward.near_wall.weight else 0.0
    car = Car.of(world.vehicle, world.sensor, threshold)
    found = [(track, phrases) for track in tracks if (phrases := _phrases(track, car))]
    if not found:
        return None
    (first, phrases), count = found[0], len(tracks)
    subject = f"track '{first.name}' does" if count == 1 else f"{len(found)} of {count} tracks do"
    place = "" if count == 1 else f"track '{first.name}': "
    sizes = ("turn_radius", "body_radius", "speed", "max_steering", "length", "width")
    keys = [f"vehicle.{name}" for name in sizes if hasattr(world.vehicle, name)]
    return (
        f"warning: {subject} not suit the car; {place}{'; '.join(phrases)}; set {', '.join(keys)} and sensor.max_range "
        "to its size, see carrl track check"
    )


def _phrases(track: Track, car: Car) -> list[str]:
    gap = gap_of(track.centreline.double().numpy())
    return [*([] if gap is None else [gap]), *unsuitable(track, car)]


def _train(trainer: Trainer, callbacks: Sequence[Callback]) -> None:
    """Trains until the run is over or stopped."""
    try:
        trainer.run(callbacks)
    except KeyboardInterrupt:  # how `interrupt` ends a compilation
        if not trainer.stopping:
            raise


def _write(path: Path, text: str) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CarrlError(f"the run's folder '{path.parents[1]}' cannot be written: {error.strerror}") from error
    write_text(path, text)


def _open_log(
    path: Path, config: Config, pipeline: Pipeline, seed: int, state: Mapping[str, Any] | None, state_file: StateFile
) -> LogWriter | None:
    env = pipeline.source.env
    if not config.get("recorder") or env is None:
        return None
    log: LogWriter = build_node(
        "recorder",
        config["recorder"],
        path=path / LOG,
        schema=log_schema(env.task, pipeline.algorithm.log_columns),
        attachments=attachments(as_yaml(config), env.tracks),
        metadata=describe_run(env.task, seed, pipeline.source.cars),
        state=state["log"] if state else None,
        make_room=state_file.make_room,
    )
    return log


def _open_scalars(path: Path, config: Config) -> Scalars | None:
    if not config.get("logger"):
        return None
    scalars: Scalars = build_node("logger", config["logger"], folder=path, config=config)
    return scalars


def as_yaml(config: Config) -> str:
    """The configuration as `.hydra/config.yaml` has it."""
    return yaml.safe_dump(config, sort_keys=False)


@contextmanager
def _naming_exhaustion() -> Iterator[None]:
    """Turns what Python, numpy and torch raise when memory runs out into one sentence."""
    try:
        yield
    except MemoryError as error:
        raise _exhausted() from error
    except RuntimeError as error:  # torch's own for the CPU; for a GPU a kind of it
        if isinstance(error, torch.OutOfMemoryError) or "allocate memory" in str(error):
            raise _exhausted() from error
        raise


def _exhausted() -> CarrlError:
    return CarrlError(
        "out of memory; set a smaller replay_buffer.capacity, env.num_envs or trainer.seeds, and train anew, or, "
        "if other programs took the memory, go on with resume="
    )


def _draw(trainer: Trainer) -> None:
    for run in trainer.runs:
        if trainer.source.transitions is None:
            _draw_learning_curve(run)
        _draw_lap(trainer.pipeline.world, run)


def _draw_learning_curve(run: ReplicateRun) -> None:
    # Here, since Matplotlib takes long to import.
    from carrl.render.curves import EvaluationCurve, draw_learning_curve

    trials, first = read_trials(run.folder.path), run.first_lap
    name = "mean speed, m/s" if trials.has_speed else "reward of the lap"
    draw_learning_curve(
        run.folder.path / LEARNING_CURVE,
        run.episode_returns,
        first_lap_episode=first.episode if first else None,
        evaluations=EvaluationCurve(trials.frames, trials.others, trials.laps, name, first.frame if first else None),
    )


def _draw_lap(world: World, run: ReplicateRun) -> None:
    from carrl.render.lap import draw_lap  # brings Matplotlib

    if run.best is not None:
        circuits, shown = world.circuits.validation, run.best.shown
        best, track = run.best.rollouts[shown], circuits[shown * len(circuits) // len(run.best.rollouts)]
        body = world.vehicle.body
        draw_lap(
            run.folder.path / LAP,
            track,
            best.poses,
            best.ranges,
            world.sensor.angles.numpy(),
            best.actions,
            action_names=world.action.names,
            body_radius=body.half_width,
            body_size=(body.length, body.width) if isinstance(body, Rectangle) else None,
            sensor_range=world.sensor.max_range,
            sensor_mount=world.sensor.mount,
            title=f"{track.name}: best greedy drive, {_in_short(best, world)}",
            collided=best.collided,
            speeds=best.speeds,
            others=best.others,
        )


def _in_short(drive: Rollout, world: World) -> str:
    """How good a drive was, in a few words."""
    if drive.mean_speed is None:
        lap = "" if drive.lap_time is None else f", lap {drive.lap_time:.2f} s"
        return f"reward {drive.lap_reward:.0f}, {drive.lap_steps} steps{lap}"
    time = drive.lap_steps * world.vehicle.time_step if drive.lap_time is None else drive.lap_time
    return f"{time:.2f} s, {drive.mean_speed:.1f} m/s on average"
