"""Small logs to learn from, written by hand."""

import json
from pathlib import Path

import torch
from tensordict import TensorDict

from carrl.log.writer import LogWriter
from carrl.sim.sensor import Sensor
from tests.logs import make_schema

STEPS = (  # car, episode, step of each transition: two cars in turn; car 0 crashes after 3 steps and begins episode 2
    *((0, 0, 0), (1, 1, 0), (0, 0, 1), (1, 1, 1), (0, 0, 2), (1, 1, 2)),
    *((0, 2, 0), (1, 1, 3), (0, 2, 1), (1, 1, 4)),
)
TIME_STEP_NS = 100_000_000
SENSOR = Sensor()
METADATA = {
    "action_names": json.dumps(["forward", "left", "right"]),
    "sensor_range_m": json.dumps(SENSOR.max_range),
    "sensor_angles_rad": json.dumps(SENSOR.angles.double().tolist()),
}


def logged_transitions(width: int = 7, action: int | None = None) -> TensorDict:
    """The 10 transitions of `STEPS`; an observation is a number, such as 0.21 in step 1 of episode 2."""
    env, episode, step = torch.tensor(STEPS).unbind(-1)
    count = len(STEPS)
    reading = episode / 10 + step / 100
    following = {
        "observation": (reading + 0.01)[:, None].expand(count, width).clone(),
        "reward": reading[:, None] * 100,
        "reward_terms": torch.zeros(count, 4),
        "terminated": ((episode == 0) & (step == 2))[:, None],
        "truncated": ((episode == 1) & (step == 4))[:, None],
        "pose": torch.zeros(count, 3),
        "gates_passed": torch.zeros(count, dtype=torch.int64),
    }
    values = {
        "observation": reading[:, None].expand(count, width).clone(),
        "action": torch.arange(count) % 3 if action is None else torch.full((count,), action),
        "episode": episode,
        "step": step,
        "car": env,
        "next_gate": torch.zeros(count, dtype=torch.int64),
        "gates_passed": torch.zeros(count, dtype=torch.int64),
        "pose": torch.zeros(count, 3),
        "action_value": torch.zeros(count, 3),
        "epsilon": torch.zeros(count),
        "exploratory": torch.zeros(count, dtype=torch.bool),
        "track": torch.zeros(count, dtype=torch.int64),
        "time_ns": torch.arange(count) // 2 * TIME_STEP_NS,
        "next": following,
    }
    return TensorDict(values, [count])


def write_log(path: Path, *batches: TensorDict, metadata: dict[str, str] | None = None) -> Path:
    """Writes a log of these batches, or of `logged_transitions()` in two; of a car with the default sensor."""
    transitions = logged_transitions()
    written = batches or (transitions[:4], transitions[4:])
    schema = make_schema(written[0]["observation"].shape[1])
    with LogWriter(path, schema=schema, attachments={}, metadata=METADATA if metadata is None else metadata) as writer:
        for batch in written:
            writer.write(batch)
    return path
