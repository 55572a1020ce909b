"""Several cars in a world as TorchRL, Gymnasium and Stable-Baselines3 see them: together, or one among opponents."""

import gymnasium
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from torchrl.envs.utils import check_env_specs

import carrl
from carrl import ContinuousActions, GymTrackEnv, Observation, Reward, Start, TrackEnv, Vehicle
from carrl.data.collector import make_collector
from carrl.errors import ConfigError
from carrl.opponents.line import LineOpponents
from carrl.opponents.rule import RuleOpponents
from carrl.sim.kinematic import Kinematic
from carrl.task.end import BumpIntoCars, End, EndAtCarContact, EndAtContact, SlideAlongWall
from carrl.task.observation import Rays
from carrl.task.racing import Progress
from carrl.task.traffic import CarContact, NearestCars, Overtaking, RaysOnCars
from carrl.task.trial import try_terms
from tests.reference.scalar_traffic import gap_between

SEES = Observation({"rays": Rays(), "on_car": RaysOnCars(), "cars": NearestCars(count=3)})
EARNS = Reward({"progress": Progress(), "overtaking": Overtaking(), "touching": CarContact()})
DRIVEN = {"vehicle": Kinematic(), "action": ContinuousActions()}
TOGETHER = {"cars_per_world": 4}
AMONG = {"cars_per_world": 4, "opponents": LineOpponents()}
WORLDS = {
    "together": TOGETHER,
    "together, told of each other": {**TOGETHER, "observation": SEES, "reward": EARNS},
    "among line": AMONG,
    "among line, driven": {**AMONG, **DRIVEN, "observation": SEES, "reward": EARNS, "start": Start(speed=5.0)},
    "among rule": {"cars_per_world": 3, "opponents": RuleOpponents(), "observation": SEES, "reward": EARNS},
    "among rule, driven": {"cars_per_world": 3, "opponents": RuleOpponents(), **DRIVEN},
}
worlds = pytest.mark.parametrize("own", WORLDS.values(), ids=WORLDS)


def others_of(env, state):
    """Poses of all the cars of each world, [W, K, 3]."""
    if env.task.has_opponents:
        return torch.cat([state["pose"][:, None], state["others", "state"][..., :3]], dim=1)
    return state["pose"].view(-1, env.simulator.cars_per_world, 3)


def stations_of(env, state):
    """Of the rows, [N], m."""
    return env.simulator.places.on_the_way(*(state[key] for key in ("pose", "track", "next_gate"))).station


def opponents_at(pace, cars=2, order="last", track="paper", **options):
    """One car among others that drive on the middle of the road at this pace."""
    line = LineOpponents(pace=pace, spread=0.0, offset=0.0)
    own = {"cars_per_world": cars, "opponents": line, "start": Start(order=order, gap=2.0), "max_steps": 10**6}
    return TrackEnv(track, seed=0, **{**own, **options})


@worlds
def test_torchrl_finds_the_specs_kept(own):
    env = TrackEnv("paper", num_envs=4, seed=0, max_steps=20, **own)
    try_terms(env.task)
    check_env_specs(env)


@worlds
def test_the_same_seed_gives_the_same_rollout_and_cars_never_overlap(own):
    first, second = (
        TrackEnv("paper", num_envs=8, seed=3, max_steps=60, **own).rollout(80, break_when_any_done=False)
        for _ in range(2)
    )
    assert (first == second).all()
    assert first["next", "done"].any()
    env = TrackEnv("paper", num_envs=8, seed=3, max_steps=60, **own)
    body = env.simulator.vehicle.body.outline
    for step in range(0, 80, 8):
        for world in others_of(env, first[:, step]).double().tolist():
            gaps = [
                gap_between(world[one], world[two], body.length, body.width)
                for one in range(len(world))
                for two in range(one)
            ]
            assert min(gaps) >= 0


def test_a_world_of_one_is_the_environment_that_it_was():
    plain, alone = (TrackEnv("paper", num_envs=4, seed=1, **own) for own in ({}, {"cars_per_world": 1}))
    assert type(alone.simulator) is type(plain.simulator)
    assert (plain.rollout(50, break_when_any_done=False) == alone.rollout(50, break_when_any_done=False)).all()


def test_cars_start_behind_each_other_with_room_between_them():
    env = TrackEnv("paper", num_envs=40, seed=0, cars_per_world=4, start=Start(gap=6.0))
    behind = (-stations_of(env, env.reset()).view(10, 4)) % env.track.length
    ordered = behind.sort(dim=1).values
    assert (ordered[:, 0] < 0.01).all()
    assert ((ordered.diff(dim=1) > 6.99 * 0.95) & (ordered.diff(dim=1) < 14.01 * 0.95)).all()
    assert len(behind.argmin(dim=1).unique()) == 4


def test_a_car_that_starts_anew_is_put_where_there_is_room():
    env = TrackEnv("paper", num_envs=8, seed=0, cars_per_world=4)
    state = env.reset()
    reset = torch.zeros(8, 1, dtype=torch.bool)
    reset[2] = reset[5] = True
    again = env.reset(state.clone().set("_reset", reset))
    moved = (again["pose"] != state["pose"]).any(dim=1)
    assert not moved[~reset[:, 0]].any()
    for world in again["pose"].view(2, 4, 3):
        distance = torch.cdist(world[:, :2], world[:, :2]) + 100 * torch.eye(4)
        assert distance.min() > 3.5
    assert (again["step"] == 0).all()


@pytest.mark.parametrize(("order", "place"), [("first", 0), ("last", 3)])
def test_the_learner_starts_first_or_last_if_it_is_to(order, place):
    env = TrackEnv("paper", num_envs=6, seed=0, start=Start(order=order), **AMONG)
    state = env.reset()
    stations = torch.cat([stations_of(env, state)[:, None], state["others", "station"]], dim=1)
    assert (((-stations) % env.track.length).argsort(dim=1)[:, place] == 0).all()


def test_line_opponents_keep_to_their_pace_and_do_not_run_into_a_car_that_stands():
    env = opponents_at(0.5, 3, "first", **DRIVEN)
    state, contacts = env.reset(), 0
    still = torch.tensor([[0.0, -1.0]])
    for _ in range(150):
        after, state = env.step_and_maybe_reset(state.set("action", still))
        contacts += int(after["next", "done"].sum())
    assert contacts == 0
    assert after["next", "others", "state"][0, :, 3].max() < 0.05


def test_line_opponents_lap_at_a_share_of_the_speed_of_cars_that_only_steer():
    env = opponents_at(0.5)
    state = env.reset()
    before = state["others", "station"].clone()
    after = env.step(state.set("action", torch.zeros(1, dtype=torch.int64)))["next", "others"]
    torch.testing.assert_close(
        (after["station"] - before) % env.track.length, torch.full((1, 1), 0.5), atol=1e-3, rtol=0
    )


def test_rule_opponents_get_round_the_track_by_themselves():
    rule = RuleOpponents(pace=0.9, spread=0.05)
    env = opponents_at(1.0, 3, track="oval", opponents=rule, end=End({"wall": SlideAlongWall()}))
    state = env.reset()
    for _ in range(int(1.6 * env.track.length)):
        state = env.step_and_maybe_reset(state.set("action", torch.zeros(1, dtype=torch.int64)))[1]
    assert (state["others", "gates_passed"] >= env.track.gate_count).all()


def test_touching_a_car_ends_an_episode_or_not_as_the_end_says():
    ended = {}
    ends = {
        "default": None,
        "both": End({"wall": EndAtContact(), "cars": EndAtCarContact()}),
        "bump": End({"wall": EndAtContact(), "cars": BumpIntoCars()}),
        "slide": End({"wall": SlideAlongWall()}),
    }
    for name, end in ends.items():
        env = opponents_at(0.1, end=end, reward=EARNS)
        state = env.reset()
        for _ in range(8):
            after, state = env.step_and_maybe_reset(state.set("action", torch.zeros(1, dtype=torch.int64)))
            if after["next", "reward_terms"][0, 2] < 0:
                break
        ended[name] = bool(after["next", "terminated"])
        if ended[name]:
            assert not after["next", "collided"]
        assert after["next", "reward_terms"][0, 2] == pytest.approx(-4 - 0.1 * 81, rel=0.02)
    assert ended == {"default": True, "both": True, "bump": False, "slide": False}


def test_passing_a_car_wins_a_place_and_being_passed_loses_it():
    env = TrackEnv("paper", num_envs=2, seed=0, cars_per_world=2, reward=EARNS, vehicle=Vehicle())
    cars = env.simulator.start(torch.tensor([10.0, 10.5]), offset=torch.tensor([0.6, -0.6]))
    state = env.task.start_at(cars).state
    turned = state.cars.state.clone()
    turned[1, 2] += torch.pi
    state.cars.state.copy_(turned)
    result = env.task.step(state, torch.zeros(2, dtype=torch.int64))
    assert result.reward_terms[:, 1].tolist() == [1, -1]


def test_a_driver_is_told_of_the_nearest_cars():
    env = TrackEnv(
        "paper", num_envs=3, seed=0, cars_per_world=3, observation=Observation({"cars": NearestCars(3, 20.0, 10.0)})
    )
    cars = env.simulator.start(torch.tensor([0.0, 4.0, 5.0]))
    seen = env.task._start_among(cars, torch.ones(3, dtype=torch.bool), None).observation.view(3, 3, 5)
    way = cars.pose[1, :2] - cars.pose[0, :2]
    torch.testing.assert_close(seen[0, 0, 1:3].norm() * 20, way.norm())
    assert seen[:, :, 0].tolist() == [[1, 1, 0]] * 3
    assert (seen[:, 2] == 0).all()
    assert seen[0, 0, 1] > 0 > seen[2, 0, 1]


@pytest.mark.parametrize("name", ["among line", "among rule"])
def test_gymnasium_and_its_vectors_drive_one_car_among_opponents(name):
    own = WORLDS[name]
    check_env(GymTrackEnv("paper", **own), skip_render_check=True)
    envs = gymnasium.make_vec("carrl/Track-v0", num_envs=3, track="paper", **own)
    alone = GymTrackEnv("paper", **own)
    first, views = envs.reset(seed=5)[0], alone.reset(seed=7)[0]
    assert (first[2] == views).all()
    for _ in range(30):
        views, *_ = envs.step(envs.action_space.sample())
    assert views.shape == envs.observation_space.shape


def test_stable_baselines_drives_cars_among_opponents():
    pytest.importorskip("stable_baselines3")
    env = carrl.sb3.make_vec_env("paper", 3, seed=0, **AMONG)
    assert env.reset().shape == (3, 7)
    for _ in range(20):
        views, *_ = env.step([0, 1, 2])
    assert views.shape == (3, 7)


def test_a_collector_that_is_put_back_goes_on_the_same():
    def made():
        env = TrackEnv("paper", num_envs=4, seed=0, max_steps=30, **AMONG)
        return env, make_collector(10, env=env, policy=env.rand_action)

    env, collector = made()
    batches = iter(collector)
    for _ in range(4):
        next(batches)
    cars, streams = collector.cars(), env.task.streams.state_dict()
    expected = next(batches)
    other, again = made()
    iterator = iter(again)
    next(iterator)
    again.load_cars(cars)
    other.task.streams.load_state_dict(streams)
    found = next(iterator)
    for key in ("observation", "action", ("next", "reward"), ("next", "others", "state")):
        assert torch.equal(found[key], expected[key])


@pytest.mark.parametrize(
    ("own", "message"),
    [
        ({"cars_per_world": 3}, r"env\.num_envs is 4; it must be a multiple of env\.cars_per_world, 3"),
        ({"cars_per_world": 0}, r"env\.cars_per_world is 0; it must be a whole number"),
        ({"opponents": LineOpponents()}, r"there are opponents, and env\.cars_per_world is 1"),
        ({"cars_per_world": 2, "opponents": "line"}, "opponents is 'line'; it must be a Opponents"),
        ({"cars_per_world": 4, "start": Start(gap=100.0)}, r"takes .* m of road; the shortest track has"),
    ],
)
def test_worlds_that_cannot_be_are_refused_in_one_sentence(own, message):
    with pytest.raises(ConfigError, match=message):
        TrackEnv("paper", num_envs=4, **own)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: LineOpponents(pace=1.5), r"opponents\.pace is 1\.5; it must be a share"),
        (lambda: LineOpponents(pace=0.5, spread=0.5), r"opponents\.spread is 0\.5; it must be less than the pace"),
        (lambda: RuleOpponents(pace=0.0), r"opponents\.pace is 0\.0; it must be a share"),
        (lambda: Start(order="middle"), r"start\.order is 'middle'; it must be random, first, last"),
        (lambda: NearestCars(count=0), "count of NearestCars is 0; it must be a whole number"),
        (lambda: End({"wall": EndAtContact(), "a": BumpIntoCars(), "b": EndAtCarContact()}), "more than one term"),
    ],
)
def test_parts_that_cannot_be_are_refused_in_one_sentence(make, message):
    with pytest.raises(ConfigError, match=message):
        make()


def test_cars_of_a_gymnasium_vector_do_not_share_a_world():
    with pytest.raises(ConfigError, match=r"cars of gymnasium\.make_vec cannot share a world"):
        gymnasium.make_vec("carrl/Track-v0", num_envs=4, track="paper", cars_per_world=2)
