"""Actions, vehicles and rewards of one's own go wherever the paper's go: TorchRL, Gymnasium, evaluation."""

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from torchrl.envs.utils import check_env_specs

from carrl import ContinuousActions, DiscreteActions, GymTrackEnv, Sensor, Start, TrackEnv, rays_and_last_action
from carrl.errors import ConfigError
from carrl.evaluation.baselines import random_policy, rule_policy
from carrl.evaluation.rollout import rollout_laps
from carrl.sim.kinematic import Kinematic
from carrl.task.action import make_table
from carrl.task.end import End, EndAtContact, NoProgress, RunningBackwards, SlideAlongWall
from carrl.task.motion import StateEntry, Velocity, WallContact
from carrl.task.observation import LastAction, Observation, Part, Scans
from carrl.task.racing import Contact, Progress, SpeedAlong, Time
from carrl.task.reward import LAP_TERMS, Collision, Gate, Proximity, Reward, Shaping, Steering
from carrl.task.road import Curvatures, HeadingError, TrackPosition
from carrl.task.task import make_task
from carrl.task.trial import try_terms
from tests.sim.vehicles import Interpreted, Odometer
from tests.worlds import make_world

STEER5 = DiscreteActions(
    ("forward", "left", "right", "half_left", "half_right"), {"steer": (0.0, 1.0, -1.0, 0.5, -0.5)}
)
CONTINUOUS = ContinuousActions(("steer",))
TERMS = {
    "collision": Collision(),
    "proximity": Proximity(),
    "gate": Gate(),
    "steering": Steering(turn=-0.5, switch=-2.0),
    "shaping": Shaping(approach=0.5, discount=0.95),
}
PARTS = {
    "steer5": {"action": STEER5, "observation": rays_and_last_action(), "reward": Reward(TERMS)},
    "continuous": {"action": CONTINUOUS, "observation": rays_and_last_action(), "reward": Reward(TERMS)},
    "odometer": {"vehicle": Odometer(), "observation": rays_and_last_action(), "reward": Reward(TERMS)},
}
RACING = {
    "progress": Progress(0.1),
    "contact": Contact(-0.2, -0.01),
    "road": SpeedAlong(0.1, -0.1, -0.1),
    "time": Time(-0.1),
    "steering": Steering(switch=-0.1),
}
SEEN = {
    "scans": Scans(3),
    "velocity": Velocity(20.0),
    "yaw_rate": StateEntry("yaw_rate"),
    "last_action": LastAction(),
    "contact": WallContact(),
    "angle": HeadingError(),
    "position": TrackPosition(),
    "curvatures": Curvatures(count=4),
}
STRICT = {"contact": EndAtContact(), "no_progress": NoProgress(steps=10)}
GENTLE = {"contact": SlideAlongWall(), "no_progress": NoProgress(steps=12), "backwards": RunningBackwards(20.0)}
TABLE = make_table({"steer": [0.0, 1.0, -0.5], "pedal": [1.0, -1.0]})
CAR = {"vehicle": Kinematic(max_acceleration=20.0), "observation": Observation(SEEN), "reward": Reward(RACING)}
PARTS |= {
    "racing": {**CAR, "action": ContinuousActions(), "end": End(GENTLE), "sensor": Sensor(mount=1.0)},
    "table": {**CAR, "action": TABLE, "end": End(STRICT), "sensor": Sensor(noise=0.0, max_range=30.0)},
}
parts = pytest.mark.parametrize("own", PARTS.values(), ids=PARTS)


@parts
@pytest.mark.parametrize("start", [Start(), Start(anywhere=True, heading_jitter=10.0)], ids=["line", "anywhere"])
def test_torchrl_finds_the_specs_kept(own, start):
    check_env_specs(TrackEnv("oval", num_envs=3, seed=0, start=start, max_steps=20, **own))


@parts
def test_random_actions_follow_the_seed_and_episodes_end(own):
    first, second = (
        TrackEnv("oval", num_envs=4, seed=3, max_steps=40, **own).rollout(90, break_when_any_done=False)
        for _ in range(2)
    )
    assert (first == second).all()
    assert first["next", "truncated"].any() or first["next", "terminated"].any()
    assert len(first["action"].unique()) >= 3
    assert first["next", "observation"].isfinite().all()


@parts
def test_gymnasiums_checker_passes(own):
    check_env(GymTrackEnv("oval", **own), skip_render_check=True)


@parts
def test_all_cars_at_once_do_what_single_ones_do(own):
    envs = gymnasium.make_vec("carrl/Track-v0", num_envs=3, track="oval", autoreset_mode=AutoresetMode.SAME_STEP, **own)
    alone = [GymTrackEnv("oval", **own) for _ in range(3)]
    views, infos = envs.reset(seed=5)
    for car, env in enumerate(alone):
        np.testing.assert_array_equal(env.reset(seed=5 + car)[0], views[car])
    envs.action_space.seed(1)
    ended = 0
    for _ in range(60):
        actions = envs.action_space.sample()
        views, rewards, terminated, _, infos = envs.step(actions)
        for car, env in enumerate(alone):
            view, reward, crashed, _, info = env.step(actions[car])
            assert (reward, crashed) == (rewards[car], terminated[car])
            if crashed:
                ended += 1
                np.testing.assert_array_equal(infos["final_obs"][car], view)
                view, info = env.reset()
            np.testing.assert_array_equal(info["pose"], infos["pose"][car])
            np.testing.assert_array_equal(view, views[car])
    assert infos["pose"].shape == (3, 3)
    assert ended


def test_half_a_turn_turns_half_as_far():
    env = TrackEnv("oval", num_envs=5, action=STEER5)
    state = env.reset()
    heading = env.step(state.set("action", torch.arange(5)))["next", "pose"][:, 2] - state["pose"][:, 2]
    yaw = env.simulator.vehicle.yaw_per_step
    torch.testing.assert_close(heading, torch.tensor([0.0, yaw, -yaw, yaw / 2, -yaw / 2]))


def test_a_continuous_turn_turns_in_proportion_and_no_farther_than_fully():
    env = TrackEnv("oval", num_envs=3, action=CONTINUOUS)
    state = env.reset()
    after = env.step(state.set("action", torch.tensor([[0.3], [-1.0], [5.0]])))["next", "pose"][:, 2]
    yaw = env.simulator.vehicle.yaw_per_step
    torch.testing.assert_close(after - state["pose"][:, 2], torch.tensor([0.3 * yaw, -yaw, yaw]))


def test_the_last_continuous_action_is_seen_as_it_is():
    env = TrackEnv("oval", num_envs=2, action=CONTINUOUS, observation=rays_and_last_action())
    state = env.reset()
    assert state["observation"].shape == (2, 8)
    assert state["observation"][:, 7].tolist() == [0, 0]
    after = env.step(state.set("action", torch.tensor([[0.25], [-1.0]])))["next", "observation"]
    assert after[:, 7].tolist() == [0.25, -1]


@pytest.mark.parametrize("action", [[1.5], [float("nan")], [0.0, 0.0]])
def test_a_continuous_action_out_of_range_is_refused(action):
    one = GymTrackEnv("oval", action=CONTINUOUS)
    one.reset()
    with pytest.raises(gymnasium.error.InvalidAction, match="it must be a number within -1 and 1 for each of steer"):
        one.step(np.array(action, np.float32))
    many = gymnasium.make_vec("carrl/Track-v0", num_envs=2, track="oval", action=CONTINUOUS)
    many.reset()
    wanted = r"must be 2 numbers .*, each a number within -1 and 1 for each of steer"
    with pytest.raises(gymnasium.error.InvalidAction, match=wanted):
        many.step(np.array([action, action], np.float32))


# A vehicle with a fourth entry in its state


def test_a_fourth_entry_of_the_state_travels_with_the_car_and_starts_anew():
    env = TrackEnv("oval", num_envs=3, seed=0, vehicle=Odometer(), max_steps=7)
    assert env.state_names == ("x", "y", "heading", "driven")
    rollout = env.rollout(15, break_when_any_done=False)
    assert rollout["state"].shape == (3, 15, 4)
    assert torch.equal(rollout["state"][..., :3], rollout["pose"])
    expected = torch.arange(15) % 7 * env.simulator.vehicle.step_length
    torch.testing.assert_close(rollout["state"][..., 3], expected.expand(3, 15).float())


def test_a_fourth_entry_changes_nothing_else():
    with_it, without = (
        TrackEnv("oval", num_envs=4, seed=1, start=Start(anywhere=True), vehicle=vehicle, reward=Reward(TERMS)).rollout(
            100, break_when_any_done=False
        )
        for vehicle in (Odometer(), Interpreted())
    )
    assert with_it["next", "terminated"].any()
    plain = (key for key in without.keys(include_nested=True, leaves_only=True) if "state" not in key)
    assert all(torch.equal(with_it[key], without[key]) for key in plain)


def test_a_fourth_entry_goes_through_evaluation():
    laps = []
    for vehicle in (Odometer(), Interpreted()):
        world = make_world("paper", vehicle=vehicle, reward=Reward(TERMS))
        laps.append(rollout_laps(world, world.simulator(world.track), rule_policy, starts=3))
    assert [lap.measures() for lap in laps[0]] == [lap.measures() for lap in laps[1]]
    assert laps[0][0].lap_completed
    assert laps[0][0].poses.shape == (laps[0][0].lap_steps + 1, 3)


# One rollout


class Recorded:
    """A term that remembers what it paid."""

    def __init__(self, term):
        self.term, self.paid = term, []

    def __call__(self, step):
        self.paid.append(self.term(step))
        return self.paid[-1]


def unsteady(policy, world):
    """Half of the actions at random: it crashes sooner or later."""
    by_chance, generator = random_policy(1, world.action), torch.Generator().manual_seed(2)

    def act(observation):
        random = torch.rand(len(observation), generator=generator) < 0.5
        return torch.where(random, by_chance(observation), policy(observation))

    return act


@pytest.mark.parametrize("steady", [True, False], ids=["rule", "half at random"])
@pytest.mark.parametrize("track", ["oval", "paper", "serpentine"])
def test_every_term_is_the_same_in_evaluation_as_in_the_environment(track, steady):
    recorded = {name: Recorded(term) for name, term in TERMS.items()}
    world = make_world(track, reward=Reward(recorded))
    policy = rule_policy if steady else unsteady(rule_policy, world)
    (attempt,) = rollout_laps(world, world.simulator(world.track), policy)
    evaluated = torch.stack([torch.cat(term.paid) for term in recorded.values()], dim=-1)
    env = TrackEnv(track, sensor=Sensor(max_range=10.0), reward=Reward(TERMS))
    state, paid = env.reset(), []
    for action in attempt.actions:
        transition, state = env.step_and_maybe_reset(state.set("action", torch.tensor([action])))
        paid.append(transition["next", "reward_terms"][0])
    assert torch.equal(torch.stack(paid), evaluated)
    names = list(TERMS)
    sums = evaluated.double().sum(0)
    lap_reward = sum(sums[names.index(name)].item() for name in LAP_TERMS)
    assert (attempt.lap_reward, attempt.steering_reward) == pytest.approx((lap_reward, sums[3].item()))
    assert (attempt.lap_completed, attempt.collided) == (steady, not steady)
    assert (evaluated != 0).any(0)[2 if steady else 0 :].all()


@pytest.mark.parametrize("own", [PARTS["steer5"], PARTS["continuous"]], ids=["steer5", "continuous"])
def test_evaluation_drives_with_other_actions(own):
    world = make_world("oval", **own)
    attempts = [rollout_laps(world, world.simulator(world.track), random_policy(3, world.action))[0] for _ in range(2)]
    assert attempts[0].measures() == attempts[1].measures()
    assert len(attempts[0].actions) == attempts[0].lap_steps > 5
    assert attempts[0].steering_reward < 0


class WrongTerm:
    """A term that gives what it is told to give."""

    def __init__(self, value, width=1):
        self.value, self.width = value, width

    def part(self, name, sensor, action):
        return Part(name, self.width, 0.0, 1.0)

    def __call__(self, _context):
        if isinstance(self.value, Exception):
            raise self.value
        return self.value


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"reward": Reward({"own": WrongTerm(torch.zeros(2, 7))})}, r"reward.own gives \[2, 7\] for 2 cars; .* \[N\]"),
        ({"reward": Reward({"own": WrongTerm(torch.tensor([0.0, torch.nan]))})}, r"reward.own gives \[0.0, nan\]"),
        ({"reward": Reward({"own": WrongTerm(3.0)})}, "reward.own gives of type float"),
        (
            {"reward": Reward({"own": WrongTerm(AttributeError("outcom"))})},
            r"reward.own: AttributeError: outcom \(.*py",
        ),
        ({"observation": Observation({"own": WrongTerm(torch.zeros(2))})}, r"observation.own gives \[2\] for 2 cars"),
        ({"observation": Observation({"own": WrongTerm(torch.zeros(2, 1), 2)})}, r"must give a tensor \[N, 2\]"),
        (
            {"observation": Observation({"own": WrongTerm(torch.full((2, 1), 9.0))})},
            "must be finite and lie in 0",
        ),
    ],
)
def test_a_term_that_gives_something_wrong_is_named_before_training(parts, message):
    task = make_task("oval", 4, **parts)
    with pytest.raises(ConfigError, match=message):
        try_terms(task)


def test_an_observation_term_without_a_width_is_named():
    with pytest.raises(ConfigError, match=r"observation.own has no method part"):
        Observation({"own": lambda context: context.ranges})
