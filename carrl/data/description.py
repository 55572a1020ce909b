"""What a log says of the world that it is recorded in and of who records it, and which columns it has."""

import json
import subprocess
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import carrl
from carrl.log.scene import STATE_UNITS, ObservationPart, Scene
from carrl.log.schema import Column, Schema
from carrl.sim.traffic import Traffic
from carrl.sim.vehicle import POSE, Rectangle
from carrl.task.task import Task
from carrl.tracks.track import Track

PACKAGES = ("torch", "torchrl", "tensordict", "gymnasium", "hydra-core", "mcap", "protobuf", "numpy", "numba")
_GIT_TIMEOUT_S = 5.0


def describe_run(task: Task, seed: int, cars: int, tracks: Sequence[Track] = ()) -> dict[str, str]:
    """The entries of a log's metadata for the replicate with this seed, who drives so many cars.

    Args:
        task: what is driven.
        seed: of the run.
        cars: side by side.
        tracks: that the log's column `track` counts; by default those of the task.
    """
    tracks = tracks or task.simulator.tracks
    entries = {
        "seed": str(seed),
        "track": tracks[0].name if len(tracks) == 1 else f"{len(tracks)} tracks",
        "num_envs": str(cars),
        "packages": json.dumps({"carrl": carrl.__version__, **_versions()}),
        **scene_of(task).entries(),
    }
    if isinstance(task.simulator, Traffic):
        entries["cars_per_world"] = str(task.simulator.cars_per_world)
        entries["rows_per_world"] = str(task.simulator.rows_per_world)
    commit = git_commit()
    return entries | ({"git_commit": commit} if commit else {})


def attachments(config: str, tracks: Sequence[Track]) -> dict[str, bytes]:
    """The files that a log has in it: the resolved configuration, and the tracks that its column `track` counts."""
    return {
        "config.yaml": config.encode(),
        **{
            f"track-{index}.json" if index else "track.json": json.dumps(track.as_dict()).encode()
            for index, track in enumerate(tracks)
        },
    }


def scene_of(task: Task) -> Scene:
    """The world of a task, without its tracks, which a log has as attachments."""
    simulator, action = task.simulator, task.action
    vehicle, body = simulator.vehicle, simulator.vehicle.body
    return Scene(
        action_names=tuple(action.names),
        control_names=tuple(action.control_names),
        observation=tuple(ObservationPart(*part) for part in task.observation_parts),
        reward_terms=task.reward.term_names,
        sensor_angles=simulator.sensor_angles.double().cpu().numpy(),
        sensor_range=simulator.sensor.max_range,
        time_step=vehicle.time_step,
        body_radius=body.half_width,
        tracks=(),
        body_size=(body.length, body.width) if isinstance(body, Rectangle) else None,
        sensor_mount=float(simulator.sensor.mount),
        friction=getattr(vehicle, "friction", None),
    )


def log_schema(task: Task, algorithm: Sequence[Column], others: int | None = None) -> Schema:
    """The columns of a log: those of the task, and those of the algorithm.

    Args:
        task: what is driven.
        algorithm: its own columns.
        others: how many cars there are beside each that is driven; by default the opponents.
    """
    if others is None:
        others = task.simulator.cars_per_world - 1 if task.has_opponents else 0
    parts = " then ".join(f"{part.width} of {part.name}" for part in task.observation_parts)
    action, names = task.action, task.simulator.vehicle.state_names
    state_key, width = "pose" if names == POSE else "state", sum(part.width for part in task.observation_parts)
    terms = task.reward.term_names
    counts = "gates of the episode passed"
    known = STATE_UNITS | {"heading": "rad counter-clockwise from +x"}
    units = ", ".join(known.get(name, name) for name in names)
    if action.names:
        chosen = ", ".join(f"{number} {name}" for number, name in enumerate(action.names))
        actions = Column("action", "action", "int64", (), chosen, narrow=True)
    else:
        controls = tuple(action.control_names)
        actions = Column("action", "action", "float32", action.spec.shape, "the controls, each in -1..1", controls)
    columns = (
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
    ends = (collided,) if task.may_end_otherwise else ()
    return Schema((*columns, *ends, *_others(others)), tuple(algorithm))


def _others(count: int) -> tuple[Column, ...]:
    """The columns of the poses of so many other cars; none where there are none."""
    if not count:
        return ()
    entries = tuple(f"{name}_{car}" for car in range(1, count + 1) for name in POSE)
    meaning = "of the other cars of the world: x m, y m, heading rad, one car after the other"
    shape = (len(entries),)
    return (
        Column("other_poses", "other_poses", "float32", shape, f"before the action, {meaning}", entries),
        Column("next_other_poses", ("next", "other_poses"), "float32", shape, f"after it, {meaning}", entries),
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
