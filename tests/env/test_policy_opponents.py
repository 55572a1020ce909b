"""Opponents that drive as an earlier run has learnt to."""

import re
import shutil
from dataclasses import replace

import gymnasium
import pytest
import torch
from torchrl.envs.utils import check_env_specs

from carrl import TrackEnv
from carrl.cli.main import main
from carrl.config import TARGETS
from carrl.errors import CarrlError
from carrl.opponents.policy import PolicyOpponents
from carrl.sim.vehicle import Vehicle
from carrl.task.episode import Start
from carrl.task.observation import Observation, Rays
from carrl.task.traffic import NearestCars
from carrl.train.run import Run
from tests.export.untrained_runs import write_untrained_run

LOOKS_BACK = (
    "observation=traffic",
    "+observation.last._target_=carrl.task.observation.LastAction",
    "+observation.scans._target_=carrl.task.observation.Scans",
    "+observation.error._target_=carrl.task.road.HeadingError",
)
"""What needs a memory and a place on the road."""
RUNS = {
    "rays": (),
    "looks back": LOOKS_BACK,
    "pedals": ("loss=sac", "vehicle=kinematic", "observation=racer"),
    "noisy": ("sensor.noise=0.3",),
    "slow": ("vehicle.speed=5.0",),
}
SHORT = ["compile=false", "recorder=null", "trainer.frames=64", "env.num_envs=8", "replay_buffer.batch_size=8"]


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Folders of runs by name; their networks have random weights."""
    root = tmp_path_factory.mktemp("opponents")
    return {name: str(write_untrained_run(root / name, *overrides)) for name, overrides in RUNS.items()}


def among(run, pace=1.0, cars=3, **parts):
    """One car among others that this run drives."""
    opponents = PolicyOpponents(run, pace=pace)
    own = {"num_envs": 4, "seed": 0, "max_steps": 40, "cars_per_world": cars, "opponents": opponents}
    return TrackEnv("paper", **{**own, **parts})


@pytest.mark.parametrize(("name", "pace"), [("rays", 1.0), ("looks back", 1.0), ("looks back", 0.6), ("pedals", 1.0)])
def test_torchrl_finds_the_specs_kept_and_the_same_seed_drives_the_same(runs, name, pace):
    world = Run(runs[name]).world
    parts = {"vehicle": world.vehicle, "action": world.action}
    check_env_specs(among(runs[name], pace, **parts))
    first, second = (among(runs[name], pace, **parts).rollout(60, break_when_any_done=False) for _ in range(2))
    assert (first == second).all()
    assert first["next", "done"].any()


@pytest.mark.parametrize("name", ["rays", "looks back", "pedals"])
def test_opponents_drive_bit_for_bit_as_the_run_drives_cars_that_are_rows(runs, name):
    run = Run(runs[name])
    world, cars = run.world, 4
    parts = {"vehicle": world.vehicle, "action": world.action, "observation": world.observation, "sensor": world.sensor}
    env = among(runs[name], cars=cars, num_envs=1, start=Start(gap=8.0), **parts).task
    rows = TrackEnv("paper", num_envs=cars, cars_per_world=cars, **parts).task
    alone = env.start()
    everyone = replace(env.simulator.everyone(alone.state.cars), station=None)
    together = rows._start_among(everyone, torch.ones(cars, dtype=torch.bool), None)
    compared = 0
    for _ in range(30):
        assert torch.equal(alone.observation, together.observation[:1])
        action = run.policy.of_many(together.observation)  # of one car alone it may be rounded otherwise
        alone, together = env.step(alone.state, action[:1]), rows.step(together.state, action)
        if bool(together.terminated.any()):
            break
        compared += 1
        assert torch.equal(env.simulator.everyone(alone.state.cars).state, together.state.cars.state)
    assert compared >= 5


def test_cars_of_a_gymnasium_vector_drive_among_them_as_each_alone(runs):
    own = {"track": "paper", "cars_per_world": 3, "opponents": PolicyOpponents(runs["looks back"])}
    together = gymnasium.make_vec("carrl/Track-v0", num_envs=3, **own)
    alone = gymnasium.make_vec("carrl/Track-v0", num_envs=1, **own)
    seen, told = together.reset(seed=5)[0], alone.reset(seed=7)[0]
    for _ in range(40):
        assert (seen[2] == told[0]).all()
        seen, told = together.step([0, 0, 0])[0], alone.step([0])[0]


def test_a_noisy_sensor_is_taken_as_exact(runs):
    assert Run(runs["noisy"]).world.sensor.noise == 0.3
    noisy, exact = (among(runs[name]).rollout(30, break_when_any_done=False) for name in ("noisy", "rays"))
    assert torch.equal(noisy["others", "state"], exact["others", "state"])


def test_an_opponent_at_half_its_pace_drives_half_as_far_on_the_same_circles(runs):
    poses = {}
    for pace in (1.0, 0.5):
        task = among(runs["rays"], pace, num_envs=1, cars=2).task
        state = task.start().state
        before = state.cars.others.state[0, 0]
        poses[pace] = before, task.step(state, torch.zeros(1, dtype=torch.int64)).state.cars.others.state[0, 0]
    ways = {pace: (after[:2] - before[:2]).norm().item() for pace, (before, after) in poses.items()}
    turns = {pace: (after[2] - before[2]).item() for pace, (before, after) in poses.items()}
    assert ways == {1.0: pytest.approx(1.0, abs=1e-4), 0.5: pytest.approx(0.5, abs=1e-4)}
    assert turns[0.5] == pytest.approx(turns[1.0] / 2, abs=1e-6)


def test_a_car_of_another_speed_drives_at_its_own_and_is_told_of_it(runs):
    sees = Observation({"rays": Rays(), "cars": NearestCars(count=1, reach=50.0, speed=10.0)})
    task = among(runs["slow"], num_envs=1, cars=2, observation=sees, start=Start(order="last", gap=2.0)).task
    begun = task.start()
    after = task.step(begun.state, torch.zeros(1, dtype=torch.int64))
    others = begun.state.cars.others
    way = (after.state.cars.others.state - others.state)[0, 0, :2].norm().item()
    assert way == pytest.approx(0.5, abs=1e-4)
    assert others.pace.item() == 0.5
    assert begun.observation[0, -2].item() == pytest.approx(-0.5, abs=1e-3)  # it comes nearer at 5 m/s


def test_an_opponent_that_touches_a_wall_is_put_back_and_forgets(runs):
    task = among(runs["looks back"], num_envs=8, cars=3, max_steps=10**6).task
    begun, forgot = task.start(), 0
    size = begun.state.cars.others.memory.shape[-1]
    state = begun.state
    for _ in range(150):
        state = task.step(state, torch.zeros(8, dtype=torch.int64)).state
        others = state.cars.others
        blank = (others.memory == 0).all(dim=-1)
        assert others.memory.shape[-1] == size
        forgot += int(blank.sum())
        middle = task.simulator.places.after(
            others.state[blank], state.cars.track[:, None].expand_as(blank)[blank], others.station[blank]
        )
        assert bool((middle.offset.abs() < 0.02).all())
    assert forgot > 0


def test_a_run_among_them_resumes_bit_for_bit_and_notices_another_network(runs, tmp_path, capsys):
    opponent = tmp_path / "opponent"
    shutil.copytree(runs["looks back"], opponent)
    among_them = [*SHORT, "opponents=policy", f"opponents.run={opponent}", "env.cars_per_world=3"]
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    assert main(["train", *among_them, "trainer.frames=128", f"hydra.run.dir={whole}"]) == 0
    assert main(["train", *among_them, f"hydra.run.dir={parts}"]) == 0
    assert main(["train", f"resume={parts}", "trainer.frames=128"]) == 0
    networks = [torch.load(each / "checkpoints" / "last.pt")["network"] for each in (whole, parts)]
    assert networks[0].keys() == networks[1].keys()
    assert all(torch.equal(networks[0][key], networks[1][key]) for key in networks[0])
    assert Run(whole).config["opponents"]["run"] == str(opponent)
    capsys.readouterr()
    other = write_untrained_run(tmp_path / "other", *RUNS["looks back"], seed=1)
    shutil.copy(other / "checkpoints" / "best.pt", opponent / "checkpoints" / "best.pt")
    assert main(["train", f"resume={parts}", "trainer.frames=192"]) == 2
    assert (
        f"began with other inputs: opponents' file '{opponent}/checkpoints/best.pt' was changed"
        in capsys.readouterr().err
    )
    shutil.rmtree(opponent)
    assert main(["evaluate", str(whole)]) == 2
    assert capsys.readouterr().err == (
        f"carrl: opponents.run is '{opponent}', which is no folder; name a run's, or put that back where it was\n"
    )


def test_a_relative_folder_is_kept_as_an_absolute_one(runs, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(runs["rays"], "earlier, run")
    words = [*SHORT, "opponents=policy", "opponents.run=earlier, run", "env.cars_per_world=2", "hydra.run.dir=run"]
    assert main(["train", *words]) == 0
    assert Run("run").config["opponents"]["run"] == str(tmp_path / "earlier, run")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"run": "nowhere"}, "opponents.run is 'nowhere', which is no folder"),
        ({"pace": 1.5}, "opponents.pace is 1.5; it must be a share"),
        ({"run": "seeds"}, "a run of 2 seeds; name one, such as"),
        ({"run": "begun"}, "which has no best network yet"),
        ({"run": "own"}, "only a run with CarRL's own parts can drive opponents"),
    ],
)
def test_a_run_that_cannot_drive_is_refused_at_once(runs, tmp_path, change, message):
    for seed in (0, 1):
        shutil.copytree(runs["rays"], tmp_path / "seeds" / f"seed={seed}")
    shutil.copytree(runs["rays"], tmp_path / "begun")
    (tmp_path / "begun" / "checkpoints" / "best.pt").unlink()
    shutil.copytree(runs["rays"], tmp_path / "own")
    config = tmp_path / "own" / ".hydra" / "config.yaml"
    config.write_text(config.read_text().replace(TARGETS["reward"][0], "own_parts.Comfort"))
    name = change.get("run")
    run = name if name == "nowhere" else runs["rays"] if name is None else str(tmp_path / name)
    with pytest.raises(CarrlError, match=re.escape(message)):
        PolicyOpponents(run, **{key: value for key, value in change.items() if key != "run"})


def test_cars_of_another_kind_and_slow_ones_with_pedals_are_refused_in_one_sentence(runs):
    with pytest.raises(CarrlError, match=r"a Kinematic with the body .* is of another kind than the one that learns"):
        among(runs["pedals"])
    with pytest.raises(
        CarrlError, match=r"a Vehicle .*radius=0\.5.* than the one that learns, a Vehicle .*radius=0\.6"
    ):
        among(runs["rays"], vehicle=Vehicle(body_radius=0.6))
    world = Run(runs["pedals"]).world
    with pytest.raises(CarrlError, match=r"opponents\.pace is 0\.5 .*chooses its speed itself; leave both out"):
        among(runs["pedals"], 0.5, vehicle=world.vehicle, action=world.action)
