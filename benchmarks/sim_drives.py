"""Who is measured by `scripts/bench sim`, and how each of them drives.

Actions are random and drawn beforehand. Cars begin anywhere on the track, and go back there after a collision.

Shapes: `N` cars.
"""

import importlib.util
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import cycle

import gymnasium
import torch
from torch import Tensor
from torchrl.envs.utils import RandomPolicy

import carrl  # registers carrl/Track-v0
from benchmarks.child import BenchError
from carrl.data.collector import make_collector
from carrl.sim.sensor import Sensor
from carrl.sim.simulator import CarState, Simulator
from carrl.sim.single_track import SingleTrack
from carrl.sim.vehicle import Vehicle, VehicleModel
from carrl.task.action import steer3
from carrl.task.episode import Start
from carrl.tracks.track import Track

GYM_ID = "carrl/Track-v0"
SEED = 0
PREPARED = 64
"""So many steps' actions are drawn, and then repeated."""
COLLECTED_STEPS = 8
"""Steps of every car in one batch of the collector."""
FEW_WALLS = 64
PAPER_CAR, PAPER_SENSOR = Vehicle(), Sensor()
F1TENTH_CAR = SingleTrack(preset="f1tenth", time_step=0.01)
F1TENTH_SENSOR = Sensor(rays=20, field_of_view=math.degrees(4.7))

Drive = Callable[[], int]
"""Drives all cars on by a step or some, and returns how many car-steps those were."""


class LeftOutError(BenchError):
    """A contestant that is not there to be measured; the message says why."""


@dataclass(frozen=True)
class Contestant:
    """Something that drives cars.

    Attributes:
        name: by which the command line chooses it.
        title: by which the tables show it.
        make: puts so many cars on a track; raises LeftOutError where it cannot be measured at all.
        paper_only: it is measured on the paper's track alone.
        one_car: it has no more.
    """

    name: str
    title: str
    make: Callable[[Track, int], Drive]
    paper_only: bool = False
    one_car: bool = False


def random_stations(track: Track, cars: int) -> Tensor:
    """Places along the track, [N], m."""
    return torch.rand(cars, dtype=torch.float64, generator=_generator()) * track.length


def put_back(collided: Tensor, start: CarState, now: CarState) -> CarState:
    """The state now, but that of the start for the cars that collided, [N]."""
    if not collided.any():
        return now
    return start.map(lambda before, after: torch.where(collided.view(-1, *[1] * (after.dim() - 1)), before, after), now)


def _drive_simulator(
    track: Track, cars: int, vehicle: VehicleModel = PAPER_CAR, sensor: Sensor = PAPER_SENSOR
) -> Drive:
    simulator = Simulator(track, vehicle, sensor)
    start = simulator.start(random_stations(track, cars))
    state, controls = start, cycle(_controls(vehicle, cars))

    def drive() -> int:
        nonlocal state
        outcome = simulator.step(state, next(controls))
        state = put_back(outcome.collided, start, outcome.cars)
        return cars

    return drive


def _controls(vehicle: VehicleModel, cars: int) -> list[Tensor]:
    """Random ones of some steps, [N, C] each; a third of the time forward for cars that do nothing but steer."""
    if vehicle.control_names == ("steer",):
        return list(map(steer3().controls, _prepared(cars)))
    generator = _generator()
    return [2 * torch.rand(cars, len(vehicle.control_names), generator=generator) - 1 for _ in range(PREPARED)]


def _drive_race_car(track: Track, cars: int) -> Drive:
    return _drive_f1tenth_gym(track, cars, whole=False)


def _drive_f1tenth(track: Track, cars: int) -> Drive:
    return _drive_simulator(track, cars, F1TENTH_CAR, F1TENTH_SENSOR)


def _drive_f1tenth_gym(track: Track, cars: int, whole: bool = True) -> Drive:
    if importlib.util.find_spec("f110_gym") is None:
        raise LeftOutError("f110_gym is not installed, and not on PyPI; see benchmarks/sim_f1tenth.py")
    from benchmarks.sim_f1tenth import make_drive

    pose = Simulator(track, F1TENTH_CAR, F1TENTH_SENSOR).start(random_stations(track, 1)).pose[0]
    step = make_drive(track, pose, F1TENTH_CAR, F1TENTH_SENSOR, whole)
    controls = cycle(torch.cat(_controls(F1TENTH_CAR, cars)).tolist())

    def drive() -> int:
        steer, speed = next(controls)
        step(steer * F1TENTH_CAR.max_steering, speed * (F1TENTH_CAR.max_speed if speed > 0 else -F1TENTH_CAR.min_speed))
        return 1

    return drive


def _drive_env(track: Track, cars: int) -> Drive:
    env = carrl.TrackEnv(track, cars, seed=SEED, start=Start(anywhere=True))
    now, actions = env.reset(), _random_actions(cars)

    def drive() -> int:
        nonlocal now
        now["action"] = next(actions)
        _, now = env.step_and_maybe_reset(now)
        return cars

    return drive


def _drive_collector(track: Track, cars: int) -> Drive:
    env = carrl.TrackEnv(track, cars, seed=SEED, start=Start(anywhere=True))
    torch.manual_seed(SEED)  # The policy draws from torch's own generator, step by step, and within the figure.
    batches = iter(make_collector(COLLECTED_STEPS, env=env, policy=RandomPolicy(env.full_action_spec)))

    def drive() -> int:
        return next(batches).numel()

    return drive


def _drive_gym(track: Track, cars: int) -> Drive:
    env = gymnasium.make(GYM_ID, track=track, start=Start(anywhere=True))
    env.reset(seed=SEED)
    actions = cycle([int(action) for action in _prepared(cars)])

    def drive() -> int:
        _, _, terminated, truncated, _ = env.step(next(actions))
        if terminated or truncated:
            env.reset()
        return 1

    return drive


def _drive_gym_vector(track: Track, cars: int) -> Drive:
    if gymnasium.spec(GYM_ID).vector_entry_point is None:
        raise LeftOutError(f"{GYM_ID} has no vector environment of its own")
    env = gymnasium.make_vec(GYM_ID, num_envs=cars, track=track, start=Start(anywhere=True))
    env.reset(seed=SEED)
    mode = env.metadata.get("autoreset_mode")
    actions = cycle([action.numpy() for action in _prepared(cars)])
    resetting = 0

    def drive() -> int:
        nonlocal resetting
        _, _, terminated, truncated, _ = env.step(next(actions))
        driven = cars - resetting
        if mode == gymnasium.vector.AutoresetMode.NEXT_STEP:  # Then the next step does not drive these cars.
            resetting = int((terminated | truncated).sum())
        return driven

    return drive


def _drive_vmas(track: Track, cars: int, walls: int | None = None) -> Drive:
    if importlib.util.find_spec("vmas") is None:
        raise LeftOutError("vmas is not installed; scripts/bench installs it")
    from benchmarks.sim_vmas import make_road, thin_out

    vehicle, sensor = Vehicle(), Sensor()
    start = Simulator(track, vehicle, sensor).start(random_stations(track, cars)).pose
    env = make_road(thin_out(track.walls, walls) if walls else track.walls, start, vehicle, sensor)
    turns = torch.tensor([0.0, 1.0, -1.0])  # of FORWARD, LEFT and RIGHT
    actions = cycle([[turns[action][:, None]] for action in _prepared(cars)])

    def drive() -> int:
        env.step(next(actions))
        return cars

    return drive


def _prepared(cars: int) -> list[Tensor]:
    """Random actions of some steps, each [N], int64."""
    generator = _generator()
    return [torch.randint(3, (cars,), generator=generator) for _ in range(PREPARED)]


def _random_actions(cars: int) -> Iterator[Tensor]:
    return cycle(_prepared(cars))


def _generator() -> torch.Generator:
    return torch.Generator().manual_seed(SEED)


VMAS = {
    "vmas": "VMAS, all walls",
    "vmas-64": f"VMAS, {FEW_WALLS} walls",
}
CONTESTANTS = {
    each.name: each
    for each in (
        Contestant("simulator", "CarRL simulator", _drive_simulator),
        Contestant("race-car", "CarRL simulator, single_track", partial(_drive_simulator, vehicle=SingleTrack())),
        Contestant("f1tenth", "CarRL simulator, F1TENTH's car, 20 rays", _drive_f1tenth, paper_only=True),
        Contestant("f1tenth-gym", "f1tenth_gym, 20 rays", _drive_f1tenth_gym, paper_only=True, one_car=True),
        Contestant("f1tenth-car", "f1tenth_gym, a RaceCar alone", _drive_race_car, paper_only=True, one_car=True),
        Contestant("env", "CarRL TrackEnv", _drive_env),
        Contestant("collector", "CarRL TrackEnv in a Collector", _drive_collector),
        Contestant("gym", "CarRL, gymnasium.make", _drive_gym, one_car=True),
        Contestant("gym-vector", "CarRL, gymnasium.make_vec", _drive_gym_vector),
        Contestant("vmas", VMAS["vmas"], _drive_vmas, paper_only=True),
        Contestant("vmas-64", VMAS["vmas-64"], partial(_drive_vmas, walls=FEW_WALLS), paper_only=True),
    )
}
