"""The simulator: cars on tracks, moved, measured and checked, one step at a time.

Shapes: `B` cars, `R` rays, `T` tracks, `G` gates. Lengths are in metres, angles in radians counter-clockwise from +x.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from carrl.errors import ConfigError
from carrl.rows import Rows
from carrl.sim.collision_geometry import CollisionGeometry, TrackLayout
from carrl.sim.geometry import (
    corners_beyond,
    crosses_forward,
    most_gates_per_step,
    path_clearance,
    ray_distances,
    rectangle_touches,
)
from carrl.sim.others import CarContact, Others
from carrl.sim.places import Place, Places
from carrl.sim.sensor import Sensor
from carrl.sim.vehicle import Disc, VehicleModel
from carrl.tracks.centreline import Routes
from carrl.tracks.track import Track

if TYPE_CHECKING:
    from carrl.sim.kernels import Kernels

_START_CLEARANCE = 1.5
"""How many radii or half widths of its body a car that starts beside the centreline keeps from the wall at least."""


@dataclass
class CarState(Rows):
    """All that the simulator knows of the cars.

    Attributes:
        state: of the vehicle model, named by its `state_names`, x m, y m, heading rad first, [B, S], float32.
        next_gate: index of the one gate of the car's track that counts next, [B], int64.
        gates_passed: since the start, [B], int64.
        track: index of the track that the car drives on, [B], int64.
        station: of the car's projection on the centreline, [B], float32, m; None where no term of a task needs it.
        others: in the same world; None where each car is alone, or where the others are rows, too, and no term of a
            task needs them here.
    """

    state: Tensor
    next_gate: Tensor
    gates_passed: Tensor
    track: Tensor
    station: Tensor | None = None
    others: Others | None = None

    @property
    def pose(self) -> Tensor:
        """X m, y m, heading rad, [B, 3]."""
        return self.state[..., :3]

    @staticmethod
    def at(state: Tensor) -> "CarState":
        """Cars in any state [B, S] on the first track, as if they headed for its first gate."""
        zeros = torch.zeros(len(state), dtype=torch.int64, device=state.device)
        return CarState(state, zeros, zeros.clone(), zeros.clone())


@dataclass
class Outcome(Rows):
    """What one step brought.

    Attributes:
        cars: after the step.
        ranges: distance to the wall along each ray, [B, R], float32, m, in [0, max_range].
        collided: the body touched a wall on the way, [B], bool.
        gates_passed: in this step, [B], int64; 0 where it collided, unless cars slide along walls.
        place: where on the road the cars are after the step; None where no term of a task needs it.
        contact: with other cars; None where each car is alone.
        on_car: whether each ray ends at a car, [B, R], bool; None where each car is alone.
    """

    cars: CarState
    ranges: Tensor
    collided: Tensor
    gates_passed: Tensor
    place: Place | None = None
    contact: CarContact | None = None
    on_car: Tensor | None = None

    @property
    def progress(self) -> Tensor:
        """Way along the centreline in this step, [B], float32, m; less than 0 backwards."""
        return self._on_the_road.progress

    @property
    def offset(self) -> Tensor:
        """From the centreline, [B], float32, m, left positive."""
        return self._on_the_road.offset

    @property
    def heading_error(self) -> Tensor:
        """The heading against the centreline's direction, [B], float32, rad, in [-pi, pi)."""
        return self._on_the_road.heading_error

    @property
    def side(self) -> Tensor:
        """The offset as a share of the way to the wall on that side, [B], float32: -1 right edge .. +1 left edge."""
        return self._on_the_road.side

    @property
    def _on_the_road(self) -> Place:
        if self.place is None:
            raise ConfigError('a term asks where on the road a car is; its class must say `needs = ("place",)`')
        return self.place


class Simulator:
    """Any number of cars side by side, each on one of the tracks; they do not see each other.

    It holds nothing of the cars: `start` and `step` return it. The time of a step does not depend on how long the
    tracks are or how many, but on how many walls a car has within reach.

    Args:
        track: where the cars drive; several, if each car is to drive on one of its own.
        vehicle: how they move.
        sensor: what they see.
        device: where the tensors live.
        slide: share of its speed along the wall that a car keeps which touches one, in each step of contact, and goes
            on along the wall; None where contact ends the episode.
        compiled: run the machine code of `carrl.sim.kernels` on the CPU, many times faster. Other devices, and False,
            run the torch code below; the two agree to float32's rounding.

    Raises:
        TrackError: the roads at a bridge cannot be told apart.
        ConfigError: there is no track, the rays start outside of the car, or it cannot slide.
    """

    cars_per_world: int = 1
    """Cars that see and touch each other."""
    memory_size: int = 0
    """Entries of an opponent's memory; 0 where they have none."""

    def __init__(
        self,
        track: Track | Sequence[Track],
        vehicle: VehicleModel,
        sensor: Sensor,
        device: torch.device | str = "cpu",
        compiled: bool = True,
        slide: float | None = None,
    ) -> None:
        """Places walls, gates and rays on the device, and compiles where that was not done before."""
        self.tracks = (track,) if isinstance(track, Track) else tuple(track)
        if not self.tracks:
            raise ConfigError("there is no track to drive on; name at least one")
        self.vehicle, self.sensor, self._slide = vehicle, sensor, slide
        if abs(sensor.mount) > vehicle.body.reach:
            raise ConfigError(
                f"sensor.mount is {sensor.mount}; it must be within the car, at most {vehicle.body.reach:g} m from its "
                "middle"
            )
        touch = vehicle.step_length + vehicle.body.reach
        reach = max(sensor.max_range + abs(sensor.mount), touch)
        geometry = CollisionGeometry.join([TrackLayout.of_track(each, reach) for each in self.tracks], reach, touch)
        self.geometry = CollisionGeometry(*(tensor.to(device) for tensor in geometry))
        self.routes = Routes([each.road for each in self.tracks], [each.gate_count for each in self.tracks])
        self.gate_counts = self.geometry.first_gate.diff()
        self.sensor_angles = sensor.angles.to(device)
        self._most_walls = geometry.longest_list
        self._most_gates_per_step = max(most_gates_per_step(each.gates, vehicle.step_length) for each in self.tracks)
        self._kernels = self._load_kernels() if compiled and self.device.type == "cpu" else None
        if slide is not None:
            from carrl.sim.contact import compile_slide  # Here, since Numba takes half a second to import.

            compile_slide(vehicle)

    def __getstate__(self) -> dict[str, Any]:
        """For pickle, with the machine code to be loaded again.

        Multiprocessing moves a tensor's memory to hand it over, and what NumPy sees of it is then no longer its own.
        """
        return vars(self) | {"_kernels": self._kernels is not None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """From what `__getstate__` told of."""
        vars(self).update(state)
        self._kernels = self._load_kernels() if state["_kernels"] else None

    @property
    def track(self) -> Track:
        """The first track: the only one, if there is one."""
        return self.tracks[0]

    @cached_property
    def places(self) -> Places:
        """Finds cars on the roads."""
        roads, gate_counts = [each.road for each in self.tracks], [each.gate_count for each in self.tracks]
        return Places(roads, gate_counts, self.vehicle.step_length)

    @property
    def device(self) -> torch.device:
        """Where the tensors live."""
        return self.geometry.walls.device

    @property
    def lap_steps(self) -> int:
        """Steps that the longest track's centreline takes."""
        return math.ceil(self.routes.lengths.max().item() / self.vehicle.step_length)

    def start(
        self,
        stations: Tensor,
        track: Tensor | None = None,
        offset: Tensor | None = None,
        heading: Tensor | None = None,
        speed: Tensor | None = None,
    ) -> CarState:
        """Cars on the road, by default on the centreline of the first track and in the driving direction.

        Args:
            stations: [B], m.
            track: index of each car's track, [B], int64.
            offset: from the centreline to the left, as a share of the room that the body has there, [B], in -1..1.
            heading: counter-clockwise from the driving direction, [B], rad.
            speed: [B], m/s; None for cars at rest, and for those that have but one speed.
        """
        stations = stations.cpu()
        track = torch.zeros(len(stations), dtype=torch.int64) if track is None else track.cpu()
        pose = self.routes.poses(track, stations)
        if offset is not None:
            pose[:, :2] += self._sideways(track, stations, pose[:, 2], offset.cpu())
        if heading is not None:
            pose[:, 2] += heading.cpu()
        next_gate = self.routes.next_gate(track, stations).to(self.device)
        state = self.vehicle.initial_state(pose, speed).to(self.device)
        return CarState(state, next_gate, torch.zeros_like(next_gate), track.to(self.device))

    def sense(self, cars: CarState) -> Tensor:
        """Distances to the wall along each ray, [B, R], float32, m, in [0, max_range]."""
        return self._walls_ahead(cars)

    def _walls_ahead(self, cars: CarState) -> Tensor:
        """The same, also of cars that share their worlds with others."""
        if self._kernels:
            return self._kernels.sense(cars.state, cars.next_gate, cars.track)
        heading = cars.state[:, 2:3].double()
        angles = heading + self.sensor_angles.double()  # In float32 this alone can cost 0.1 mm.
        origins = cars.state[:, :2] + self.sensor.mount * torch.cat([heading.cos(), heading.sin()], dim=1)
        return ray_distances(origins, angles, self._walls_near(cars), self.sensor.max_range).to(cars.state)

    def step(self, cars: CarState, control: Tensor) -> Outcome:
        """Moves every car by one time step.

        The body is swept along the straight way of the step, a rectangle with the heading after it, so that no wall is
        jumped over at any speed.
        A gate counts when the middle of the car crosses it forward and it is the next one in order; nothing else
        counts, so going back and forth over a gate earns nothing, nor does driving the wrong way round. A car whose
        pose is not finite has collided. A car that slides along walls is never in one after a step.

        Args:
            cars: before the step.
            control: named by the vehicle's `control_names`, [B, C], float32.
        """
        outcome = self._drive(cars, control)
        return outcome if self._slide is None else self._slid(cars, outcome, self._slide)

    def _drive(self, cars: CarState, control: Tensor) -> Outcome:
        """The step of cars that end in a wall where they touch one."""
        if self._kernels:
            state, next_gate, gates_passed, ranges, collided, passed = self._kernels.step(
                cars.state, control, cars.next_gate, cars.gates_passed, cars.track
            )
            if not self.vehicle.body.by_corners:  # the machine code knows of no such bodies
                return Outcome(CarState(state, next_gate, gates_passed, cars.track), ranges, collided, passed)
        else:
            state = self.vehicle.step(cars.state, control)
        return self._followed(cars, state)

    def follow(self, cars: CarState, state: Tensor) -> Outcome:
        """What becomes of cars that drive to these states, [B, S], in one step; they end in a wall that they touch."""
        if not self._kernels or self.vehicle.body.by_corners:
            return self._followed(cars, state)
        counts = cars.next_gate, cars.gates_passed, cars.track
        next_gate, gates_passed, ranges, collided, passed = self._kernels.follow(cars.state, state, *counts)
        return Outcome(CarState(state, next_gate, gates_passed, cars.track), ranges, collided, passed)

    def _followed(self, cars: CarState, state: Tensor) -> Outcome:
        """The same without machine code."""
        begin, end = cars.state[:, :2].double(), state[:, :2].double()
        walls = self._walls_near(replace(cars, state=state))
        body = self.vehicle.body
        if isinstance(body, Disc):
            collided = ~(path_clearance(begin, end, walls) >= body.radius)  # also where it is nan
        else:
            touches = corners_beyond if body.by_corners else rectangle_touches
            collided = touches(begin, end, state[:, 2].double(), body.half_size, walls) | ~end.isfinite().all(dim=-1)
        passed = torch.where(collided, 0, self._count_gates(begin, end, cars))
        next_gate = (cars.next_gate + passed) % self.gate_counts[cars.track]
        after = CarState(state, next_gate, cars.gates_passed + passed, cars.track)
        return Outcome(after, self._walls_ahead(after), collided, passed)

    def _slid(self, cars: CarState, outcome: Outcome, kept: float) -> Outcome:
        """The outcome with those cars outside of the walls that touched one."""
        touched = outcome.collided
        if not touched.any():
            return outcome
        from carrl.sim.contact import slide

        before, after = cars[touched], outcome.cars[touched]
        pose, direction = slide(before.state, after.state, self._walls_near(after), self.vehicle.body)
        state = torch.where(after.state.isfinite(), after.state, before.state)  # what is no number would stay so
        state = self.vehicle.after_contact(state, pose, direction, kept)
        passed = self._count_gates(before.pose[:, :2].double(), pose[:, :2].double(), before)
        next_gate = (before.next_gate + passed) % self.gate_counts[before.track]
        after = CarState(state, next_gate, before.gates_passed + passed, before.track)
        return outcome.replacing(touched, Outcome(after, self._walls_ahead(after), touched[touched], passed))

    def place(self, cars: CarState) -> Place:
        """Where on the road the cars are, near their last stations; without those, on the way to their next gates."""
        if cars.station is None:
            return self.places.on_the_way(cars.state, cars.track, cars.next_gate)
        return self.places.after(cars.state, cars.track, cars.station)

    def has_lapped(self, cars: CarState, laps: int = 1) -> Tensor:
        """Whether each car has passed all gates so many times since its start: [...], bool."""
        return cars.gates_passed >= laps * self.gate_counts[cars.track]

    def gate_distance(self, cars: CarState) -> Tensor:
        """How far each car is from the middle of the gate that counts next, in a straight line, [B], float32, m."""
        gate = self.geometry.gates[self.geometry.first_gate[cars.track] + cars.next_gate].unflatten(-1, (2, 2))
        return torch.linalg.vector_norm(gate.mean(dim=1) - cars.state[:, :2], dim=-1)

    def progress(self, cars: CarState, start_stations: Tensor) -> Tensor:
        """Share of the lap driven since the start, [B], in [0, 1]; the start's stations are [B], m.

        Measured along the centreline, and only as far as the gates passed in order vouch for it.
        """
        track, passed = cars.track.cpu(), cars.gates_passed.cpu()
        length, gate_count = self.routes.lengths[track], self.gate_counts.cpu()[track]
        start = start_stations.cpu() % length
        gate_gap = length / gate_count
        first_gate = (self.routes.next_gate(track, start) + 1) * gate_gap
        first_gate = torch.where(first_gate <= start, first_gate + length, first_gate)
        low = torch.where(passed == 0, start, first_gate + (passed - 1) * gate_gap)
        high = first_gate + passed * gate_gap
        station = self.routes.nearest_stations(track, cars.state[:, :2].cpu(), low, high)
        return torch.where(passed >= gate_count, 1.0, ((station - start) / length).clamp(0, 1))

    def _load_kernels(self) -> "Kernels":
        from carrl.sim.kernels import Kernels  # Here, since Numba takes half a second to import.

        most_gates = self._most_gates_per_step
        return Kernels(self.geometry, self.sensor, self.vehicle, most_gates)

    def _sideways(self, track: Tensor, stations: Tensor, heading: Tensor, offset: Tensor) -> Tensor:
        """From the centreline, square to the heading [B], as far towards a wall as the offset [B] says: [B, 2], m."""
        left, right = (
            (self.routes.clearance(track, stations) - _START_CLEARANCE * self.vehicle.body.half_width).clamp(min=0).T
        )
        shift = torch.where(offset > 0, left, right) * offset
        return shift[:, None] * torch.stack([-heading.sin(), heading.cos()], dim=-1)

    def _walls_near(self, cars: CarState) -> Tensor:
        deck = self.geometry.deck(cars.track, cars.next_gate)
        return self.geometry.walls_near(cars.state[:, :2], deck, self._most_walls)

    def _count_gates(self, begin: Tensor, end: Tensor, cars: CarState) -> Tensor:
        """Gates crossed forward and in order on the straight ways begin-end, [B], int64."""
        first, count = self.geometry.first_gate[cars.track], self.gate_counts[cars.track]
        passed = torch.zeros_like(cars.next_gate)
        for _ in range(self._most_gates_per_step):
            gate = self.geometry.gates[first + (cars.next_gate + passed) % count].unflatten(-1, (2, 2))
            passed = passed + crosses_forward(begin, end, gate)
        return passed
