"""How well an agent's network predicts what it sees.

Shapes: `F` transitions.
"""

import torch
from tensordict import TensorDictBase

from carrl.data.replay_buffer import KEYS
from carrl.train.learner import Agent

MOST_TRANSITIONS = 256
"""Of more transitions than these an even sample is measured, so that it takes little time."""


def td_error(agent: Agent, transitions: TensorDictBase) -> float:
    """The mean absolute TD error of an agent on some transitions [F], as its loss defines it."""
    every = -(-len(transitions) // MOST_TRANSITIONS)
    sample = transitions[::every].select(*KEYS)
    with torch.no_grad():
        agent.loss(sample)  # which notes the squared errors as priorities
    return sample["td_error"].sqrt().mean().item()


def mean_action_value(transitions: TensorDictBase) -> float:
    """The mean value of the actions chosen in some transitions [F], as they were when chosen."""
    chosen = transitions["action_value"].gather(-1, transitions["action"][:, None])
    return chosen.mean().item()
