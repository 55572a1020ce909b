"""What a trainer does beside training (record, measure, evaluate), and what a log says of its run.

Shapes: `A` replicates, `F` transitions of each.
"""

import json
import subprocess
import time
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from tensordict import TensorDictBase

import carrl
from carrl.data.replay_buffer import KEYS
from carrl.data.source import Round
from carrl.env.track_env import TrackEnv
from carrl.evaluation.results import EvaluationResult, Rollout
from carrl.evaluation.rollout import rollout
from carrl.log.messages import Metrics
from carrl.log.scene import STATE_UNITS, ObservationPart, Scene
from carrl.log.schema import Column, Schema
from carrl.sim.simulator import Simulator
from carrl.sim.traffic import Traffic
from carrl.sim.vehicle import POSE, Rectangle
from carrl.train.plan import EvaluationPlan

if TYPE_CHECKING:
    from carrl.train.trainer import Trainer

PACKAGES = ("torch", "torchrl", "tensordict", "gymnasium", "hydra-core", "mcap", "protobuf", "numpy", "numba")
_GIT_TIMEOUT_S = 5.0


def describe_run(env: TrackEnv, seed: int, cars: int) -> dict[str, str]:
    """The entries of a log's metadata for the replicate with this seed, who drives so many cars."""
    entries = {
        "seed": str(seed),
        "track": env.track.name if len(env.tracks) == 1 else f"{len(env.tracks)} tracks",
        "num_envs": str(cars),
        "packages": json.dumps({"carrl": carrl.__version__, **_versions()}),
        **scene_of(env).entries(),
    }
    if isinstance(env.simulator, Traffic):
        entries["cars_per_world"] = str(env.simulator.cars_per_world)
        entries["rows_per_world"] = str(env.simulator.rows_per_world)
    commit = git_commit()
    return entries | ({"git_commit": commit} if commit else {})


def scene_of(env: TrackEnv) -> Scene:
    """The world of an environment, without its tracks, which a log has as attachments."""
    vehicle, action, body = env.simulator.vehicle, env.task.action, env.simulator.vehicle.body
    return Scene(
        action_names=tuple(action.names),
        control_names=tuple(action.control_names),
        observation=tuple(ObservationPart(*part) for part in env.task.observation_parts),
        reward_terms=env.task.reward.term_names,
        sensor_angles=env.sensor_angles.double().cpu().numpy(),
        sensor_range=env.sensor_range,
        time_step=vehicle.time_step,
        body_radius=body.half_width,
        tracks=(),
        body_size=(body.length, body.width) if isinstance(body, Rectangle) else None,
        sensor_mount=float(env.simulator.sensor.mount),
        friction=getattr(vehicle, "friction", None),
    )


def log_schema(env: TrackEnv, algorithm: Sequence[Column]) -> Schema:
    """The columns of a log: those of the environment, and those of the algorithm."""
    parts = " then ".join(f"{part.width} of {part.name}" for part in env.task.observation_parts)
    action, names = env.task.action, env.state_names
    state_key, width = "pose" if names == POSE else "state", env.observation_spec["observation"].shape[-1]
    terms = env.task.reward.term_names
    counts = "gates of the episode passed"
    known = STATE_UNITS | {"heading": "rad counter-clockwise from +x"}
    units = ", ".join(known.get(name, name) for name in names)
    if action.names:
        chosen = ", ".join(f"{number} {name}" for number, name in enumerate(action.names))
        actions = Column("action", "action", "int64", (), chosen, narrow=True)
    else:
        controls = tuple(action.control_names)
        actions = Column("action", "action", "float32", action.spec.shape, "the controls, each in -1..1", controls)
    task = (
        Column("observation", "observation", "float32", (width,), f"before the action: {parts}"),
        actions,
        Column("reward", ("next", "reward"), "float32", (1,), "sum of the reward terms"),
        Column("reward_terms", ("next", "reward_terms"), "float32", (len(terms),), "what each term paid", terms),
        Column("next_observation", ("next", "observation"), "float32", (width,), f"after the action: {parts}"),
        Column("terminated", ("next", "terminated"), "bool", (1,), "the episode ended here, in a terminal state"),
        Column("truncated", ("next", "truncated"), "bool", (1,), "the episode was cut here, in no terminal state"),
        Column("episode", "episode", "int64", (), "number of the episode within the run"),
        Column("step", "step", "int64", (), "index of the transition within its episode, from 0", narrow=True),
        Column("car", "car", "int64", (), "index of the car among those simulated side by side, from 0", narrow=True),
        Column("track", "track", "int64", (), "index of the car's track among the attached ones", narrow=True),
        Column("state", state_key, "float32", (len(names),), f"before the action: {units}", names),
        Column(
            "next_state",
            ("next", state_key),
            "float32",
            (len(names),),
            f"after the action: {units}",
            names,
        ),
        Column("next_gate", "next_gate", "int64", (), "index of the gate to pass next, before the action", narrow=True),
        Column("gates_passed", "gates_passed", "int64", (), f"{counts} before the action", narrow=True),
        Column("next_gates_passed", ("next", "gates_passed"), "int64", (), f"{counts} after the action", narrow=True),
        Column("time_ns", "time_ns", "int64", (), "simulated time before the action, since the start of the run, ns"),
    )
    collided = Column("collided", ("next", "collided"), "bool", (1,), "touching a wall ended the episode here")
    ends = (collided,) if env.task.may_end_otherwise else ()
    return Schema((*task, *ends, *_others(env)), tuple(algorithm))


def _others(env: TrackEnv) -> tuple[Column, ...]:
    """The columns of the opponents' poses; none where there are no opponents."""
    if not env.task.has_opponents:
        return ()
    width = env.observation_spec["other_poses"].shape[-1]
    entries = tuple(f"{name}_{car}" for car in range(1, width // 3 + 1) for name in POSE)
    meaning = "of the other cars of the world: x m, y m, heading rad, one car after the other"
    return (
        Column("other_poses", "other_poses", "float32", (width,), f"before the action, {meaning}", entries),
        Column("next_other_poses", ("next", "other_poses"), "float32", (width,), f"after it, {meaning}", entries),
    )


def git_commit() -> str | None:
    """The commit of the checkout that this code runs from, with "-dirty" after it where files differ; None if none."""
    root = Path(carrl.__file__).resolve().parents[1]
    if not (root / ".git").exists():
        return None
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        return subprocess.run(
            command, capture_output=True, text=True, timeout=_GIT_TIMEOUT_S, check=True
        ).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return None


def _versions() -> dict[str, str]:
    versions = {}
    for package in PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            continue
    return versions


LOGGED_TOGETHER = 2048
"""Env steps of each replicate after which they are logged."""
LOGGED_WITHIN_S = 1.0
"""Wall time after which they are logged, if they are fewer."""
METRICS_INTERVAL_S = 0.5
"""Wall time for each replicate after which learning is measured with the next transitions logged; it takes 2 ms."""


class Callback:
    """Follows a training run; override what is of use."""

    def on_start(self, trainer: "Trainer") -> None:
        """Called once, before the first round."""

    def on_round(self, trainer: "Trainer") -> None:
        """Called after every round of collecting and learning; `trainer.stop()` ends the run, all of it saved."""

    def on_end(self) -> None:
        """Called once after the last round, also where an error ended the run."""

    def on_collected(self, trainer: "Trainer", batch: Round) -> None:
        """A round's transitions are in the memory, and nothing was learnt from them yet."""

    def on_learnt(self, trainer: "Trainer", batch: Round) -> None:
        """All updates of a round are made."""

    def on_flush(self, trainer: "Trainer") -> None:
        """Nothing may be held back: the state is to be saved, or replicates' runs end."""

    def on_limit(self, trainer: "Trainer", replicates: Sequence[int]) -> None:
        """These replicates have reached a limit; their runs end after this."""

    def state_dict(self) -> dict[str, Any]:
        """What is to be remembered."""
        return {}

    def load_state_dict(self, state: Mapping[str, Any], trainer: "Trainer") -> None:
        """Goes on from there, as the trainer does."""


class Recorder(Callback):
    """Writes transitions to the logs, many at once, which costs little more than a few."""

    def __init__(self) -> None:
        self._keys: list[Any] = []
        self._waiting: list[TensorDictBase] = []
        self._logged, self._logged_at = 0, time.monotonic()
        self._measured, self._measured_at = 0, self._logged_at

    def load_state_dict(self, state: Mapping[str, Any], trainer: "Trainer") -> None:
        """Goes on from there; the logs are written up to there."""
        self._logged = self._measured = trainer.frames

    def on_collected(self, trainer: "Trainer", batch: Round) -> None:
        """Keeps the transitions to be logged together, and logs them when that is due."""
        if batch.transitions is None or trainer.source.env is None:
            return
        if not self._keys:
            schema = log_schema(trainer.source.env, trainer.algorithm.log_columns)
            self._keys = list(dict.fromkeys([*schema.keys, *KEYS]))  # the columns, and what the loss reads besides
        self._waiting.append(batch.transitions.select(*self._keys).clone())
        if trainer.frames - self._logged >= LOGGED_TOGETHER or time.monotonic() >= self._logged_at + LOGGED_WITHIN_S:
            self.on_flush(trainer)
        if trainer.learner.learns_for_the_first_time:  # half a minute, in which a kill would lose them
            self.on_flush(trainer)
            for run in trainer.active.values():
                run.folder.flush()

    def on_flush(self, trainer: "Trainer") -> None:
        """Logs the transitions since the last call."""
        if not self._waiting:
            return
        transitions, now = torch.cat(self._waiting), time.monotonic()
        self._waiting, self._logged, self._logged_at = [], trainer.frames, now  # none again after a failure
        for index, run in trainer.active.items():
            run.folder.record(transitions[:, index])
        if now >= self._measured_at + METRICS_INTERVAL_S * len(trainer.runs):
            self._measure(trainer, transitions, now)

    def _measure(self, trainer: "Trainer", transitions: TensorDictBase, now: float) -> None:
        """Logs how every replicate's learning goes, measured on these transitions [F, A]."""
        rate = (trainer.frames - self._measured) / (now - self._measured_at)
        self._measured, self._measured_at = trainer.frames, now
        if not any(run.folder.takes_metrics for run in trainer.active.values()):
            return
        losses, figures = trainer.learner.losses.tolist(), trainer.algorithm.measure(transitions)
        for index, run in trainer.active.items():
            metrics = Metrics(
                frame=trainer.frames,
                updates=trainer.updates,
                loss=losses[index],
                frames_per_second=rate,
                figures=figures[index],
            )
            run.folder.add_metrics(metrics)


class LoggedProgress(Callback):
    """Where transitions come from logs, adds a row for each round to the tables, as there are no episodes."""

    def on_learnt(self, trainer: "Trainer", batch: Round) -> None:
        """Measures every replicate on a fixed sample of the logged transitions."""
        sample = trainer.source.sample
        if sample is None:
            return
        for run, figures in zip(trainer.runs, trainer.algorithm.measure_logged(sample), strict=True):
            status = run.status
            row = {"updates": status.updates, "loss": status.loss, **figures, "wall_time_s": status.wall_time_s}
            run.folder.add_learnt(row)


class Evaluator(Callback):
    """Greedy laps of every validation circuit, every so many env steps and at the end.

    Args:
        plan: how often, from how many places, and how many laps; None for one from the start line, at the end alone.
    """

    def __init__(self, plan: EvaluationPlan | None) -> None:
        self._interval = plan.interval if plan else None
        self._starts, self._laps = (plan.starts, plan.laps) if plan else (1, 1)
        self._evaluated_at, self._round_began_at = -1, 0
        self._simulator: Simulator | None = None  # where transitions come from logs, there is none before the end

    def state_dict(self) -> dict[str, Any]:
        """When the latest evaluation was."""
        return {"evaluated_at": self._evaluated_at}

    def load_state_dict(self, state: Mapping[str, Any], trainer: "Trainer") -> None:
        """Goes on from there."""
        self._evaluated_at, self._round_began_at = state["evaluated_at"], trainer.frames

    def on_learnt(self, trainer: "Trainer", batch: Round) -> None:
        """Evaluates if the round has passed a multiple of the interval."""
        before, self._round_began_at = self._round_began_at, trainer.frames
        if self._interval is not None and trainer.frames // self._interval > before // self._interval:
            self._evaluate(trainer)

    def on_limit(self, trainer: "Trainer", replicates: Sequence[int]) -> None:
        """Evaluates the networks as they are, unless that was done."""
        if self._evaluated_at != trainer.frames:
            self._evaluate(trainer)

    def _evaluate(self, trainer: "Trainer") -> None:
        self._evaluated_at = trainer.frames
        evaluations = self.drive(trainer)
        for index, run in trainer.active.items():
            run.add_evaluation(evaluations[index], trainer.status(run.status.loss))

    def drive(self, trainer: "Trainer") -> list[EvaluationResult]:
        """The evaluation of every replicate's network, all driven side by side."""
        world, replicates = trainer.pipeline.world, len(trainer.runs)
        circuits, starts = len(world.circuits.validation), self._starts
        if self._simulator is None:
            self._simulator = world.simulator(world.circuits.validation, trainer.algorithm.collect_policy.device)
        track = torch.arange(circuits).repeat_interleave(starts).repeat(replicates)
        stations = self._simulator.routes.lengths[track] * torch.arange(starts).repeat(circuits * replicates) / starts
        drives_each = circuits * starts

        def of_replicates(drives: Sequence[Rollout]) -> list[EvaluationResult]:
            begins = range(0, len(drives), drives_each)
            return [EvaluationResult(tuple(drives[begin : begin + drives_each])) for begin in begins]

        def shown(drives: Sequence[Rollout]) -> list[int]:
            return [number * drives_each + result.shown for number, result in enumerate(of_replicates(drives))]

        policy = trainer.algorithm.greedy_policy
        return of_replicates(rollout(world, self._simulator, policy, stations, track, kept=shown, laps=self._laps))
