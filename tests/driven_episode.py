"""A small episode of a car with pedals, written by hand: it speeds up, turns to the left and brakes."""

from dataclasses import replace

import numpy as np
import pytest

from carrl.log.trace import EpisodeTrace

NAMES = ("x", "y", "heading", "speed", "yaw_rate", "slip", "steering", "acceleration", "lateral_acceleration")
STEER = np.array([0.0, 0.0, 0.25, 0.5, 1.0, 0.5, 0.0, -0.5])
PEDAL = np.array([1.0, 1.0, 1.0, 0.5, 0.0, -0.5, -1.0, 0.25])
SPEED = np.array([0.0, 2.0, 4.0, 6.0, 7.0, 7.0, 6.0, 4.0, 4.5])
"""Before each step and after the last, m/s."""
MOUNT = 1.5


@pytest.fixture(scope="session")
def pedals(trace: EpisodeTrace) -> EpisodeTrace:
    """Its first steps as if a car with pedals had driven them: 4 m by 1.8 m, with grip for 1.2 g; no ray is true."""
    steps = len(STEER)
    columns = {name: values[:steps] for name, values in trace.columns.items()}
    del columns["action_value"], columns["epsilon"]
    poses = np.zeros((steps + 1, 3))
    for step in range(steps):
        heading = poses[step, 2] + 0.1 * STEER[step]
        way = 0.1 * SPEED[step + 1]
        poses[step + 1] = (
            poses[step, 0] + way * np.cos(heading),
            poses[step, 1] + way * np.sin(heading),
            heading,
        )
    poses[:, :2] += (8.0, 3.0)
    ahead = np.append(0.0, np.diff(SPEED)) / 0.1
    aside = np.append(0.0, STEER) * SPEED
    others = [np.append(0.0, STEER), 0.01 * np.arange(steps + 1), np.append(0.0, 0.4 * STEER), ahead, aside]
    states = np.column_stack([poses, SPEED, *others]).astype(np.float32)
    columns |= {
        "action": np.column_stack([STEER, PEDAL]).astype(np.float32),
        "state": states[:-1],
        "next_state": states[1:],
        "log_prob": np.linspace(-1, 0, steps).astype(np.float32),
    }
    scene = replace(
        trace.scene,
        action_names=("continuous",),
        control_names=("steer", "pedal"),
        body_radius=0.9,
        body_size=(4.0, 1.8),
        sensor_mount=MOUNT,
        friction=1.2,
    )
    return EpisodeTrace(scene, columns, {"state": NAMES, "next_state": NAMES, "action": ("steer", "pedal")})
