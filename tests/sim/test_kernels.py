"""The compiled step and sense: against the torch code, and what compiling must not change."""

import copy
import math
import os
import pickle
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from numba.core import event
from torch import Tensor

from carrl.sim.collision_geometry import CollisionGeometry, TrackLayout
from carrl.sim.geometry import path_clearance, ray_distances
from carrl.sim.kernels import Kernels
from carrl.sim.sensor import Sensor
from carrl.sim.simulator import CarState, Simulator
from carrl.sim.vehicle import Bicycle, Vehicle, VehicleModel
from carrl.tracks.track import Track, builtin_names
from tests.sim.shapes import random_poses, random_track
from tests.sim.steering import ACTIONS, FORWARD, LEFT, RIGHT, steer, tensors, tensors_of
from tests.sim.vehicles import Interpreted, Odometer

exactly = settings(derandomize=True, deadline=None, max_examples=60)
TRACKS = [*builtin_names(), *range(3)]
"""Names of built-in tracks, and seeds of random ones."""
UNDECIDED = 1e-5
"""Clearances this close to the body radius, m, may fall to either side by the rounding of float32 in torch."""


def track_of(name: str | int) -> Track:
    return random_track(name) if isinstance(name, int) else Track.load(name)


def both(
    track: Track, vehicle: VehicleModel | None = None, sensor: Sensor | None = None
) -> tuple[Simulator, Simulator]:
    """The compiled simulator and the plain one."""
    options = track, vehicle or Vehicle(), sensor or Sensor()
    return Simulator(*options), Simulator(*options, compiled=False)


def random_cars(simulator: Simulator, count: int, seed: int) -> tuple[CarState, Tensor]:
    """Cars anywhere, half of them with the gate next that is, and their controls."""
    generator = torch.Generator().manual_seed(seed)
    stations = simulator.track.length * torch.rand(count, generator=generator, dtype=torch.float64)
    state = simulator.start(stations)
    pose = random_poses(simulator.track, count, seed)
    pose[: count // 2] = state.pose[: count // 2] + 0.5 * torch.randn(count // 2, 3, generator=generator)
    gates_passed = torch.randint(100, (count,), generator=generator)
    actions = torch.randint(len(ACTIONS), (count,), generator=generator)
    return replace(state, state=pose, gates_passed=gates_passed), steer(actions)


def ring_of_walls(corners: int, radius: float) -> Tensor:
    angle = torch.arange(corners, dtype=torch.float64) * 2 * math.pi / corners
    points = radius * torch.stack([angle.cos(), angle.sin()], dim=1)
    return torch.stack([points, points.roll(-1, 0)], dim=1)


def geometry_of(walls: Tensor, reach: float) -> CollisionGeometry:
    gates, deck_of_gate = torch.tensor([[[0.0, 1.0], [0.0, -1.0]]]), torch.zeros(1, dtype=torch.int64)
    return CollisionGeometry.join(
        [TrackLayout(walls, gates, torch.ones(1, len(walls)).bool(), deck_of_gate)], reach, touch=1.5
    )


def kernels_among(walls: Tensor, angles: Tensor, max_range: float = 20.0) -> Kernels:
    sensor = SimpleNamespace(angles=angles, rays=len(angles), max_range=max_range, mount=0)
    return Kernels(geometry_of(walls, max(max_range, 1.5)), sensor, Vehicle(), most_gates=1)


def sense_among(walls: Tensor, angles: Tensor, pose: Tensor, max_range: float = 20.0) -> Tensor:
    return kernels_among(walls, angles, max_range).sense(pose, *torch.zeros(2, len(pose), dtype=torch.int64))


# Against torch


@pytest.mark.parametrize("speed", [10.0, 60.0])
@pytest.mark.parametrize("name", TRACKS)
def test_a_step_equals_that_of_torch(name: str | int, speed: float):
    compiled, plain = both(track_of(name), Vehicle(speed=speed))
    state, control = random_cars(plain, 2000, seed=1)
    ours, theirs = compiled.step(state, control), plain.step(state, control)
    # Cosines may differ in their last bit, which moves a rounded coordinate by as much.
    torch.testing.assert_close(ours.cars.pose[:, :2], theirs.cars.pose[:, :2], atol=1e-6, rtol=2**-23)
    assert torch.equal(ours.cars.pose[:, 2], theirs.cars.pose[:, 2])
    ends = (pose[:, :2].double() for pose in (state.pose, ours.cars.pose))
    clearance = path_clearance(*ends, plain.track.walls.double())
    assert torch.equal(ours.collided, clearance < plain.vehicle.body_radius)
    decided = (clearance - plain.vehicle.body_radius).abs() > UNDECIDED
    assert decided.float().mean() > 0.99
    assert ours.gates_passed.any() and ours.collided.any()
    counts = "collided", "gates_passed"
    assert all(torch.equal(getattr(ours, name)[decided], getattr(theirs, name)[decided]) for name in counts)
    assert torch.equal(ours.cars.next_gate[decided], theirs.cars.next_gate[decided])
    assert torch.equal(ours.cars.gates_passed[decided], theirs.cars.gates_passed[decided])
    torch.testing.assert_close(ours.ranges, plain.sense(ours.cars), atol=1e-5, rtol=0)


def test_a_bicycle_steps_as_in_torch():
    compiled, plain = both(Track.load("paper"), Bicycle())
    state, control = random_cars(plain, 2000, seed=1)
    ours, theirs = compiled.step(state, control), plain.step(state, control)
    torch.testing.assert_close(ours.cars.pose, theirs.cars.pose, atol=1e-5, rtol=0)
    assert torch.equal(ours.collided, theirs.collided)
    assert torch.equal(ours.gates_passed, theirs.gates_passed)


@pytest.mark.parametrize("sensor", [Sensor(), Sensor(rays=1, max_range=300.0), Sensor(rays=40, field_of_view=359.0)])
@pytest.mark.parametrize("name", TRACKS)
def test_ranges_equal_those_of_torch(name: str | int, sensor: Sensor):
    compiled, plain = both(track_of(name), sensor=sensor)
    pose = random_poses(plain.track, 1000, seed=2)
    cars = CarState.at(pose)
    torch.testing.assert_close(compiled.sense(cars), plain.sense(cars), atol=1e-5, rtol=0)


@exactly
@given(
    st.lists(st.tuples(*[st.integers(-6, 6)] * 4), min_size=1, max_size=12),
    st.tuples(st.integers(-6, 6), st.integers(-6, 6)),
    st.sampled_from([0.0, 0.3, math.pi / 4, math.pi / 2, -3 * math.pi / 4]),
)
def test_ranges_equal_those_of_torch_among_parallel_touching_and_empty_walls(ends, origin, heading):
    walls, angles = torch.tensor(ends).float().view(-1, 2, 2), Sensor().angles
    pose = torch.tensor([[*origin, heading]])
    expected = ray_distances(pose[:, :2], pose[:, 2:].double() + angles.double(), walls, 20.0)
    torch.testing.assert_close(sense_among(walls, angles, pose), expected, atol=1e-5, rtol=0)


def test_no_ray_slips_through_the_joint_of_two_walls():
    walls = ring_of_walls(corners=17, radius=12.0)
    generator = torch.Generator().manual_seed(0)
    origins = 14 * torch.rand(2000, 2, generator=generator) - 7
    for corner in walls[:, 0]:
        to_corner = corner - origins.double()
        heading = torch.atan2(to_corner[:, 1], to_corner[:, 0]).float()
        ranges = sense_among(walls, torch.zeros(1), torch.cat([origins, heading[:, None]], dim=1), 100.0)
        torch.testing.assert_close(ranges[:, 0].double(), to_corner.norm(dim=1), atol=1e-4, rtol=0)


@pytest.mark.parametrize("max_range", [6.0, 11.999, 12.001, 40.0])
def test_a_wall_counts_up_to_the_very_range(max_range: float):
    """Walls beyond the range are left out unseen, so the last that are not are the ones to look at."""
    walls, angles = ring_of_walls(corners=4, radius=12 * math.sqrt(2)), torch.tensor([math.pi / 4])
    range_ = sense_among(walls, angles, torch.zeros(1, 3), max_range)
    assert range_.item() == pytest.approx(min(12.0, max_range))


@pytest.mark.parametrize("max_range", [0.01, 10.0, 1000.0])
@pytest.mark.parametrize("speed", [1.0, 300.0, 1e4])
def test_collisions_depend_on_neither_speed_nor_range_of_the_rays(max_range: float, speed: float):
    compiled, plain = both(track_of(0), Vehicle(speed=speed), Sensor(max_range=max_range))
    state, control = random_cars(plain, 1000, seed=3)
    outcome = compiled.step(state, control)
    ends = (pose[:, :2].double() for pose in (state.pose, outcome.cars.pose))
    assert torch.equal(outcome.collided, path_clearance(*ends, plain.track.walls.double()) < plain.vehicle.body_radius)


@pytest.mark.parametrize(("y", "collided"), [(0.49, True), (0.51, False)])
@pytest.mark.parametrize("end", [0, 1])
def test_passing_either_end_of_a_free_standing_wall_closely_collides(end: int, y: float, collided: bool):
    wall = torch.tensor([[2.0, y], [2.0, 5.0]])
    walls = (wall if end == 0 else wall.flip(0))[None]
    counts = torch.zeros(3, 1, dtype=torch.int64)
    *_, hit, _ = kernels_among(walls, torch.zeros(1)).step(torch.tensor([[1.5, 0.0, 0.0]]), torch.zeros(1, 1), *counts)
    assert hit.item() is collided


@pytest.mark.parametrize("turn_radius", [7.2, 0.05])
@pytest.mark.parametrize("half_turns", [1, -1, 3, -7])
def test_the_heading_wraps_as_in_torch(half_turns: int, turn_radius: float):
    compiled, plain = both(Track.load("oval"), Vehicle(turn_radius=turn_radius))
    heading = torch.tensor(half_turns * math.pi) + torch.linspace(-0.2, 0.2, 41)
    heading = torch.cat([heading, torch.tensor(half_turns * math.pi).nextafter(torch.tensor([-9.0, 9.0]))])
    pose = torch.cat([torch.zeros(len(heading), 2), heading[:, None]], dim=1)
    for action in ACTIONS:
        state = CarState.at(pose)
        actions = torch.full((len(pose),), action)
        after = compiled.step(state, steer(actions)).cars.pose[:, 2]
        assert torch.equal(after, plain.step(state, steer(actions)).cars.pose[:, 2])
        assert after.abs().max() <= torch.tensor(math.pi)


@pytest.mark.parametrize("name", ["oval", "paper", "serpentine"])
def test_episodes_end_as_in_torch_after_hundreds_of_steps(name: str):
    """The rule drives, and sometimes chance, until the car collides."""
    compiled, plain = both(Track.load(name))
    generator = torch.Generator().manual_seed(4)
    ours = theirs = plain.start(torch.linspace(0, plain.track.length, 12, dtype=torch.float64))
    ranges, driving = plain.sense(theirs), torch.ones(12, dtype=torch.bool)
    for _ in range(300):
        to_left = ranges[:, 4:].sum(-1) - ranges[:, :3].sum(-1)
        action = torch.where(to_left > 0.5, LEFT, torch.where(to_left < -0.5, RIGHT, FORWARD))
        by_chance = torch.rand(12, generator=generator) < 0.1
        action = torch.where(by_chance, torch.randint(3, (12,), generator=generator), action)
        new, old = compiled.step(ours, steer(action)), plain.step(theirs, steer(action))
        ours, theirs, ranges = new.cars, old.cars, old.ranges
        assert torch.equal(new.collided[driving], old.collided[driving])
        assert torch.equal(new.gates_passed[driving], old.gates_passed[driving])
        driving &= ~old.collided
    assert (ours.pose - theirs.pose)[driving].abs().max() < 1e-3
    assert torch.equal(ours.gates_passed[driving], theirs.gates_passed[driving])
    assert theirs.gates_passed[driving].max() >= plain.track.gate_count, "no car drove a lap"


# What compiling must not change


def test_a_car_fares_alone_as_among_a_thousand_bit_for_bit():
    simulator = Simulator(Track.load("serpentine"), Vehicle(), Sensor())
    state, control = random_cars(simulator, 1000, seed=5)
    together = simulator.step(state, control)
    for index in range(0, 1000, 7):
        car = slice(index, index + 1)
        one = state[car]
        alone = simulator.step(one, control[car])
        assert all(torch.equal(own, all_[car]) for own, all_ in zip(tensors(alone), tensors(together), strict=True))
        assert torch.equal(simulator.sense(one), simulator.sense(state)[car])


def test_outputs_are_new_tensors_of_the_stated_types():
    simulator = Simulator(Track.load("paper"), Vehicle(), Sensor())
    state, control = random_cars(simulator, 5, seed=6)
    first = simulator.step(state, control)
    kept = [tensor.clone() for tensor in tensors(first)]
    simulator.step(first.cars, control)
    assert all(map(torch.equal, tensors(first), kept))
    types = [torch.float32, torch.int64, torch.int64, torch.int64, torch.float32, torch.bool, torch.int64]
    assert [tensor.dtype for tensor in tensors(first)] == types
    assert len({tensor.untyped_storage().data_ptr() for tensor in [*tensors(first), *tensors_of(state), control]}) == 11


def test_inputs_of_another_layout_or_type_give_the_same_and_compile_nothing():
    simulator = Simulator(Track.load("paper"), Vehicle(), Sensor())
    state, control = random_cars(simulator, 6, seed=7)
    expected = simulator.step(state, control)
    strided = state.map(lambda values: torch.stack([values, values], -1)[..., 0])
    assert not any(tensor.is_contiguous() for tensor in tensors_of(strided))
    wide = state.map(lambda values: values.double() if values.is_floating_point() else values.int())
    with event.install_recorder("numba:compile") as compilations:
        for other in (strided, wide):
            outcome = simulator.step(other, control.double())
            assert all(map(torch.equal, tensors(outcome), tensors(expected)))
            assert torch.equal(simulator.sense(other), simulator.sense(state))
    assert not compilations.buffer


def test_a_pose_that_is_no_number_spoils_nothing_else():
    compiled, plain = both(Track.load("oval"))
    state, control = random_cars(plain, 6, seed=8)
    state.state[[0, 2, 4], [0, 1, 2]] = torch.tensor([math.nan, math.inf, -math.inf])
    ours, theirs = compiled.step(state, control), plain.step(state, control)
    for one, other in zip(tensors(ours), tensors(theirs), strict=True):
        torch.testing.assert_close(one, other, equal_nan=True, atol=1e-5, rtol=0)


@pytest.mark.parametrize("short", range(5))
def test_inputs_of_unequal_numbers_of_cars_are_refused(short: int):
    simulator = Simulator(Track.load("oval"), Vehicle(), Sensor())
    state, control = random_cars(simulator, 3, seed=9)
    inputs = [tensor[:2] if index == short else tensor for index, tensor in enumerate([*tensors_of(state), control])]
    with pytest.raises(ValueError, match="the same number of cars"):
        simulator.step(CarState(*inputs[:4]), inputs[4])
    with pytest.raises(ValueError, match="begin with a pose"):
        simulator.sense(replace(state, state=state.pose[:, :2]))


@pytest.mark.parametrize("wrong", [-1, 99])
@pytest.mark.parametrize("field", ["next_gate", "track"])
def test_a_gate_or_a_track_that_is_not_there_is_refused(field: str, wrong: int):
    simulator = Simulator(Track.load("oval"), Vehicle(), Sensor())
    state, control = random_cars(simulator, 3, seed=9)
    elsewhere = replace(state, **{field: torch.tensor([0, wrong, 0])})
    with pytest.raises(ValueError, match="index is not one of those"):
        simulator.step(elsewhere, control)
    with pytest.raises(ValueError, match="index is not one of those"):
        simulator.sense(elsewhere)


@pytest.mark.parametrize("wrong", [-1, 3])
def test_an_action_that_the_car_does_not_have_is_refused(wrong: int):
    simulator = Simulator(Track.load("oval"), Vehicle(), Sensor())
    state, _ = random_cars(simulator, 3, seed=9)
    with pytest.raises(IndexError):
        simulator.step(state, steer(torch.tensor([0, wrong, 0])))


def test_threads_may_step_at_the_same_time():
    simulator = Simulator(Track.load("paper"), Vehicle(), Sensor())
    cars = [random_cars(simulator, 3000, seed) for seed in range(4)]
    expected = [simulator.step(*each) for each in cars]
    with ThreadPoolExecutor(4) as pool:
        outcomes = list(pool.map(lambda each: simulator.step(*each), 5 * cars))
    for outcome, alone in zip(outcomes, 5 * expected, strict=True):
        assert all(map(torch.equal, tensors(outcome), tensors(alone)))


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda simulator: pickle.loads(pickle.dumps(simulator))])
def test_a_copy_of_a_simulator_steps_like_the_original(copied):
    simulator = Simulator(Track.load("oval"), Vehicle(), Sensor())
    state, control = random_cars(simulator, 4, seed=10)
    ours, copys = (each.step(state, control) for each in (simulator, copied(simulator)))
    assert all(map(torch.equal, tensors(ours), tensors(copys)))


DOUBLED = """
from carrl.machine_code import compiled
@compiled
def doubled(value):
    return 2 * value
"""
CALL_ONCE = """
from numba.core import event
with event.install_recorder("numba:compile") as compilations:
    {}
print("compiled" if compilations.buffer else "from the cache")
"""


@pytest.fixture
def call_doubled(tmp_path: Path) -> list[str]:
    """A command that calls a compiled function and says whether that compiled it."""
    (tmp_path / "module.py").write_text(DOUBLED)
    code = CALL_ONCE.format("import module; assert module.doubled(21) == 42")
    return [sys.executable, "-c", f"import sys; sys.path.insert(0, {str(tmp_path)!r}){code}"]


def test_several_processes_may_compile_at_once_and_later_ones_do_not(call_doubled, tmp_path: Path):
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    processes = [subprocess.Popen(call_doubled, env=environment, stdout=subprocess.PIPE) for _ in range(2)]
    for process in processes:
        process.communicate()
    later = subprocess.run(call_doubled, env=environment, capture_output=True, text=True, check=True).stdout
    assert [process.returncode for process in processes] == [0, 0]
    assert later == "from the cache\n"


def test_without_a_folder_for_the_cache_it_compiles_all_the_same(call_doubled):
    environment = os.environ | {"NUMBA_CACHE_LOCATOR_CLASSES": "UserProvidedCacheLocator"}
    environment.pop("NUMBA_CACHE_DIR", None)
    output = subprocess.run(call_doubled, env=environment, capture_output=True, text=True)
    assert (output.returncode, output.stderr, output.stdout) == (0, "", "compiled\n")


def test_a_later_process_takes_the_simulators_machine_code_from_the_cache():
    Simulator(Track.load("oval"), Vehicle(), Sensor())
    code = "import carrl; carrl.TrackEnv('oval', num_envs=2).rollout(3)"
    output = subprocess.run([sys.executable, "-c", CALL_ONCE.format(code)], capture_output=True, text=True)
    assert output.stdout == "from the cache\n"


def test_numba_is_imported_for_a_compiled_simulator_only():
    code = """
import sys, carrl
from carrl.sim import sensor, simulator, vehicle
from carrl.tracks import track
simulator.Simulator(track.Track.load("oval"), vehicle.Vehicle(), sensor.Sensor(), compiled=False)
print("numba" in sys.modules)
"""
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "False\n"


# Vehicles without machine code


@pytest.mark.parametrize("name", TRACKS)
def test_a_vehicle_without_machine_code_steps_in_torch_and_the_same(name: str | int):
    compiled, interpreted = both(track_of(name))[0], both(track_of(name), Interpreted())[0]
    state, control = random_cars(compiled, 2000, seed=1)
    ours, theirs = compiled.step(state, control), interpreted.step(state, control)
    torch.testing.assert_close(theirs.cars.pose[:, :2], ours.cars.pose[:, :2], atol=1e-6, rtol=2**-23)
    assert torch.equal(theirs.cars.pose[:, 2], ours.cars.pose[:, 2])
    ends = (pose[:, :2].double() for pose in (state.pose, ours.cars.pose))
    clearance = path_clearance(*ends, compiled.track.walls.double())
    decided = (clearance - compiled.vehicle.body_radius).abs() > UNDECIDED
    assert decided.float().mean() > 0.99
    for one, other in zip(
        tensors(ours)[1:4] + tensors(ours)[5:], tensors(theirs)[1:4] + tensors(theirs)[5:], strict=True
    ):
        assert torch.equal(one[decided], other[decided])
    torch.testing.assert_close(theirs.ranges, interpreted.sense(theirs.cars), atol=1e-5, rtol=0)


@pytest.mark.parametrize("compiled", [True, False])
def test_what_else_is_in_a_state_is_the_vehicles_own_business(compiled: bool):
    simulators = [both(Track.load("oval"), vehicle)[0 if compiled else 1] for vehicle in (Odometer(), Interpreted())]
    cars = [each.start(torch.tensor([0.0, 20.0])) for each in simulators]
    assert cars[0].state[:, 3].tolist() == [0, 0]
    for action in (FORWARD, LEFT, RIGHT, LEFT):
        control = steer(torch.tensor([action, FORWARD]))
        own, plain = (each.step(state, control) for each, state in zip(simulators, cars, strict=True))
        cars = [own.cars, plain.cars]
        assert torch.equal(own.cars.pose, plain.cars.pose)
        assert all(map(torch.equal, tensors(own)[1:], tensors(plain)[1:]))
    torch.testing.assert_close(cars[0].state[:, 3], torch.full((2,), 4 * Odometer().step_length))
