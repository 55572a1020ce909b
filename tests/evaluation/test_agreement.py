"""What a drive earns in an evaluation is what the same actions earn in the environment, term by term."""

import pytest
import torch

from carrl import TrackEnv, Vehicle
from carrl.evaluation.baselines import random_policy, rule_policy
from carrl.evaluation.rollout import rollout_laps
from carrl.sim.kinematic import Kinematic
from carrl.task.action import ContinuousActions
from carrl.task.observation import Observation, Scans, rays_only
from carrl.task.racing import Contact, Progress, SpeedAlong, Time
from carrl.task.reward import Collision, Gate, Proximity, Reward, Shaping, Steering
from carrl.task.road import HeadingError
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


RACING = {
    "progress": Progress(0.1),
    "contact": Contact(-0.2, -0.01),
    "road": SpeedAlong(0.1, -0.1, -0.1),
    "time": Time(-0.1),
    "steering": Steering(switch=-0.1),
}


@pytest.mark.parametrize("observation", [rays_only(), Observation({"scans": Scans(2), "angle": HeadingError()})])
def test_a_race_earns_the_same_in_both(observation):
    """A car that drives off and hits a wall, after some hundred metres."""
    terms = {name: Noting(term) for name, term in RACING.items()}
    for name in ("progress", "road"):
        terms[name].needs = ("place",)
    parts = {"vehicle": Kinematic(), "action": ContinuousActions(("steer", "pedal")), "observation": observation}
    world = make_world("oval", reward=Reward(terms), **parts)
    generator = torch.Generator().manual_seed(2)

    def policy(seen):
        turn = (seen[:, 4:7].sum(1) - seen[:, :3].sum(1)) / seen[:, :7].sum(1)
        pedal = 0.4 + 0.6 * torch.rand(len(seen), generator=generator)
        return torch.stack([(4 * turn).clamp(-1, 1), pedal], dim=1)

    (driven,) = rollout_laps(world, world.simulator(world.track), policy)
    evaluated = torch.stack([torch.cat(term.noted).float() for term in terms.values()], dim=1)
    env = TrackEnv(world.track, sensor=world.sensor, reward=Reward(RACING), **parts)
    now, in_env = env.reset(), []
    for action in driven.actions:
        transition, now = env.step_and_maybe_reset(now.set("action", torch.from_numpy(action)[None]))
        in_env.append(transition["next", "reward_terms"][0])
    assert torch.equal(evaluated[: driven.lap_steps], torch.stack(in_env))
    assert driven.collided and driven.lap_steps > 20
    assert (torch.stack(in_env) != 0).any(0).all()
