"""A small episode to look at, written by hand: a quarter round a square, over one gate, and into a wall."""

import numpy as np
import pytest

from carrl.log.scene import ObservationPart, Scene, TrackShape
from carrl.log.trace import EpisodeTrace

SQUARES = {
    "inner": np.array([(6, 6), (14, 6), (14, 14), (6, 14)], dtype=np.float64),
    "outer": np.array([(0, 0), (20, 0), (20, 20), (0, 20)], dtype=np.float64),
}
"""Corners of the walls to the left and to the right of the driving direction, [4, 2], m."""
GATES = [[(14, 10), (20, 10)], [(10, 14), (10, 20)], [(6, 10), (0, 10)], [(10, 6), (10, 0)]]
TURN = np.pi / 6
DISTANCE = 1.5
FORWARD, LEFT, RIGHT = range(3)
ACTIONS = [
    FORWARD,
    FORWARD,
    LEFT,
    LEFT,
    LEFT,
    FORWARD,
    RIGHT,
    LEFT,
    FORWARD,
    FORWARD,
    FORWARD,
    FORWARD,
    FORWARD,
    FORWARD,
]


@pytest.fixture(scope="session")
def track_shape() -> TrackShape:
    """A square road, 6 m wide, driven counter-clockwise from (10, 3), with 4 gates."""
    walls = np.concatenate([np.stack([corners, np.roll(corners, -1, 0)], 1) for corners in SQUARES.values()])
    centreline = np.array([(10, 3), (17, 3), (17, 17), (3, 17), (3, 3)], dtype=np.float64)
    return TrackShape("square", 56.0, centreline, walls, np.array(GATES, dtype=np.float64))


@pytest.fixture(scope="session")
def scene(track_shape: TrackShape) -> Scene:
    """A car with 5 rays of 10 m; a turn changes the heading by 30 degrees, then the car moves 1.5 m."""
    return Scene(
        action_names=("forward", "left", "right"),
        control_names=("steer",),
        observation=(ObservationPart("rays", 5, 0.0, 1.0),),
        reward_terms=("collision", "proximity", "gate", "steering"),
        sensor_angles=np.linspace(-np.pi / 2, np.pi / 2, 5),
        sensor_range=10.0,
        time_step=0.1,
        body_radius=0.5,
        tracks=(track_shape,),
    )


@pytest.fixture(scope="session")
def trace(scene: Scene) -> EpisodeTrace:
    """Episode 7 of car 2: 14 steps, the 7th exploratory, gate 0 passed in the 8th, a collision in the last."""
    steps = len(ACTIONS)
    poses = _drive()
    readings = (_ranges(poses, scene) / scene.sensor_range).astype(np.float32)
    passed = (poses[:-1, 1] < 10) & (poses[1:, 1] >= 10)
    last = np.arange(steps) == steps - 1
    near = readings[1:].min(axis=1) < 0.1
    terms = np.stack([-200 * last, -20 * near, 50 * passed, np.zeros(steps)], axis=1).astype(np.float32)
    values = 100 + 5 * np.sin(np.arange(steps)[:, None] + np.arange(3)) + 10 * np.eye(3)[ACTIONS]
    columns: dict[str, np.ndarray] = {
        "observation": readings[:-1],
        "action": np.array(ACTIONS, dtype=np.int64),
        "reward": terms.sum(axis=1, keepdims=True),
        "reward_terms": terms,
        "next_observation": readings[1:],
        "terminated": last[:, None],
        "truncated": np.zeros((steps, 1), dtype=np.bool_),
        "episode": np.full(steps, 7),
        "step": np.arange(steps),
        "car": np.full(steps, 2),
        "state": poses[:-1].astype(np.float32),
        "next_state": poses[1:].astype(np.float32),
        "next_gate": passed.cumsum() - passed,
        "gates_passed": passed.cumsum() - passed,
        "next_gates_passed": passed.cumsum(),
        "action_value": values.astype(np.float32),
        "epsilon": np.linspace(0.2, 0.1, steps, dtype=np.float32),
        "exploratory": np.arange(steps) == 6,
        "track": np.zeros(steps, dtype=np.int64),
        "time_ns": 5_000_000_000 + 100_000_000 * np.arange(steps),
    }
    return EpisodeTrace(scene, columns)


@pytest.fixture(scope="session")
def among_others(trace: EpisodeTrace) -> EpisodeTrace:
    """The same among two other cars: one stands on the left straight, one drives on the upper one, to the left."""
    standing = np.tile((3.0, 8.0, -np.pi / 2), (len(trace) + 1, 1))
    driving = np.column_stack([16 - 0.5 * np.arange(len(trace) + 1), np.full((len(trace) + 1, 2), (17.0, np.pi))])
    poses = np.hstack([standing, driving]).astype(np.float32)
    return EpisodeTrace(trace.scene, {**trace.columns, "other_poses": poses[:-1], "next_other_poses": poses[1:]})


def _drive() -> np.ndarray:
    """Poses from the start line, [T + 1, 3], m, m, rad."""
    poses = [np.array([10.0, 3.0, 0.0])]
    for action in ACTIONS:
        turn = (0, TURN, -TURN)[action]
        direction = poses[-1][2] + turn
        poses.append(poses[-1] + (DISTANCE * np.cos(direction), DISTANCE * np.sin(direction), turn))
    return np.array(poses)


def _ranges(poses: np.ndarray, scene: Scene) -> np.ndarray:
    """Distance to the nearest wall along each ray, at most the sensor's range, [T + 1, R], m."""
    angles = poses[:, 2:] + scene.sensor_angles
    rays = np.stack([np.cos(angles), np.sin(angles)], axis=-1)[:, :, None]
    first, second = scene.tracks[0].walls[:, 0], scene.tracks[0].walls[:, 1]
    along, reach = second - first, first - poses[:, None, None, :2]
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = _cross(reach, along) / _cross(rays, along)
        place = _cross(reach, rays) / _cross(rays, along)
    hit = (distance >= 0) & (place >= 0) & (place <= 1)
    return np.where(hit, distance, scene.sensor_range).min(axis=-1).clip(max=scene.sensor_range)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
