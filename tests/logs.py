"""The columns of logs that are written by hand."""

from collections.abc import Mapping, Sequence

import numpy as np
from tensordict import TensorDict

from carrl.log.codec import tensordict_of
from carrl.log.schema import Column, Schema

ACTIONS = ("forward", "left", "right")
TERMS = ("collision", "proximity", "gate", "steering")
POSE = ("x", "y", "heading")


def make_schema(
    rays: int = 7,
    actions: Sequence[str] = ACTIONS,
    terms: Sequence[str] = TERMS,
    algorithm: Sequence[Column] | None = None,
) -> Schema:
    """The columns of a car with so many rays that learns with DQN."""
    return Schema(
        (
            Column("observation", "observation", "float32", (rays,), "before the action"),
            Column("action", "action", "int64", (), "index of the action", narrow=True),
            Column("reward", ("next", "reward"), "float32", (1,), "sum of the reward terms"),
            Column("reward_terms", ("next", "reward_terms"), "float32", (len(terms),), "of the reward", tuple(terms)),
            Column("next_observation", ("next", "observation"), "float32", (rays,), "after the action"),
            Column("terminated", ("next", "terminated"), "bool", (1,), "the episode ended here"),
            Column("truncated", ("next", "truncated"), "bool", (1,), "the episode was cut here"),
            Column("episode", "episode", "int64", (), "number of the episode"),
            Column("step", "step", "int64", (), "index of the step", narrow=True),
            Column("car", "car", "int64", (), "index of the car", narrow=True),
            Column("track", "track", "int64", (), "index of the track", narrow=True),
            Column("state", "pose", "float32", (3,), "before the action", POSE),
            Column("next_state", ("next", "pose"), "float32", (3,), "after the action", POSE),
            Column("next_gate", "next_gate", "int64", (), "index of the gate to pass next", narrow=True),
            Column("gates_passed", "gates_passed", "int64", (), "before the action", narrow=True),
            Column("next_gates_passed", ("next", "gates_passed"), "int64", (), "after the action", narrow=True),
            Column("time_ns", "time_ns", "int64", (), "simulated time, ns"),
        ),
        tuple(dqn_columns(actions) if algorithm is None else algorithm),
    )


def dqn_columns(actions: Sequence[str] = ACTIONS) -> tuple[Column, ...]:
    """What DQN says of a transition."""
    return (
        Column("action_value", "action_value", "float32", (len(actions),), "Q-values", tuple(actions)),
        Column("epsilon", "epsilon", "float32", (), "probability of a random action"),
        Column("exploratory", "exploratory", "bool", (), "the action was drawn at random"),
    )


def schema_of(columns: Mapping[str, np.ndarray]) -> Schema:
    """The columns of these arrays."""
    return make_schema(
        columns["observation"].shape[1],
        [f"a{index}" for index in range(columns["action_value"].shape[1])],
        [f"r{index}" for index in range(columns["reward_terms"].shape[1])],
    )


def transitions_of(columns: Mapping[str, np.ndarray]) -> TensorDict:
    """The transitions in TorchRL's layout."""
    return tensordict_of(columns, schema_of(columns))
