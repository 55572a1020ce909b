"""What a drive earns in an evaluation is what the same actions earn in the environment, term by term."""

import pytest
import torch

from carrl import TrackEnv, Vehicle
from carrl.evaluation.baselines import random_policy, rule_policy
from carrl.evaluation.rollout import rollout_laps
from carrl.task.reward import Collision, Gate, Proximity, Reward, Shaping, Steering
from tests.worlds import make_world

TERMS = {
    "collision": Collision(),
    "proximity": Proximity(threshold=0.3),
    "gate": Gate(),
    "steering": Steering(turn=-1.0, switch=-2.0),
    "shaping": Shaping(approach=0.5, discount=0.95),
}


class Noting:
    """A term that notes what it gives."""

    def __init__(self, term):
        self.term, self.noted = term, []

    def __call__(self, step):
        self.noted.append(self.term(step))
        return self.noted[-1]


def noisy_rule():
    """The rule, with a random action every few steps, so that it switches, comes near walls and hits some."""
    step, chance = 0, random_policy(5, make_world().action)

    def act(observation):
        nonlocal step
        step += 1
        return chance(observation) if step % 3 == 0 else rule_policy(observation)

    return act


@pytest.mark.parametrize("track", ["oval", "paper", "serpentine"])
@pytest.mark.parametrize("policy", [lambda: rule_policy, noisy_rule], ids=["rule", "noisy rule"])
def test_an_evaluation_earns_what_the_environment_gives_in_every_term(track, policy):
    terms = {name: Noting(term) for name, term in TERMS.items()}
    world = make_world(track, reward=Reward(terms), vehicle=Vehicle(turn_radius=6.3))
    (driven,) = rollout_laps(world, world.simulator(world.track), policy())
    evaluated = torch.stack([torch.cat(term.noted).float() for term in terms.values()], dim=1)

    env = TrackEnv(world.track, vehicle=world.vehicle, sensor=world.sensor, reward=Reward(TERMS))
    now, in_env, done = env.reset(), [], []
    for action in driven.actions:
        transition, now = env.step_and_maybe_reset(now.set("action", torch.tensor([action])))
        in_env.append(transition["next", "reward_terms"][0])
        done.append(transition["next", "terminated"].item())
    assert torch.equal(evaluated[: driven.lap_steps], torch.stack(in_env))
    assert done == [False] * (driven.lap_steps - 1) + [driven.collided]
    sums = torch.stack(in_env).sum(dim=0)
    assert driven.lap_reward == pytest.approx(sums[:3].sum().item())
    assert driven.steering_reward == pytest.approx(sums[3].item())
    assert sums[2] > 0 and sums[4] != 0
