"""The simulator: cars on a track, moved, measured and checked, one step at a time.

Shapes: `B` cars, `R` rays, `S` walls, `G` gates. Lengths are in metres, angles in radians counter-clockwise from +x.
"""

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import shapely
import torch
from torch import Tensor

from carrl.sim.geometry import cross, path_clearance, ray_distances
from carrl.sim.sensor import Sensor
from carrl.sim.track import Track
from carrl.sim.vehicle import Vehicle

if TYPE_CHECKING:
    from carrl.sim.kernels import Kernels


class State(NamedTuple):
    """All that the simulator knows of the cars.

    Attributes:
        pose: x m, y m, heading rad, [B, 3], float32.
        next_gate: index of the one gate that counts next, [B], int64.
        gates_passed: since the start, [B], int64.
    """

    pose: Tensor
    next_gate: Tensor
    gates_passed: Tensor


class Outcome(NamedTuple):
    """What one step brought.

    Attributes:
        state: after the step.
        ranges: distance to the wall along each ray, [B, R], float32, m, in [0, max_range].
        collided: the body touched a wall on the way, [B], bool.
        gates_passed: in this step, [B], int64; 0 where it collided.
    """

    state: State
    ranges: Tensor
    collided: Tensor
    gates_passed: Tensor


class Simulator:
    """Any number of cars side by side on one track; they do not see each other.

    It holds no state of the cars: `start` and `step` return it.

    Args:
        track: where the cars drive.
        vehicle: how they move.
        sensor: what they see.
        device: where the tensors live.
        compiled: run the machine code of `carrl.sim.kernels` on the CPU, many times faster. Other devices, and False,
            run the torch code below; the two agree to float32's rounding.
    """

    def __init__(
        self,
        track: Track,
        vehicle: Vehicle,
        sensor: Sensor,
        device: torch.device | str = "cpu",
        compiled: bool = True,
    ) -> None:
        """Places walls, gates and rays on the device, and compiles where that was not done before."""
        self.track, self.vehicle, self.sensor = track, vehicle, sensor
        self.walls = track.walls.to(device)
        self.gates = track.gates.to(device)
        self.sensor_angles = sensor.angles.to(device)
        self._most_gates_per_step = _most_gates_per_step(track.gates, vehicle.step_length)
        self._kernels = self._load_kernels() if compiled and self.device.type == "cpu" else None

    @property
    def device(self) -> torch.device:
        """Where the tensors live."""
        return self.walls.device

    @property
    def lap_steps(self) -> int:
        """Steps that the centreline's length takes."""
        return math.ceil(self.track.length / self.vehicle.step_length)

    def start(self, stations: Tensor) -> State:
        """Cars on the centreline, pointing in the driving direction: stations [B], m."""
        stations = stations.cpu()
        pose = self.track.pose_at(stations).to(self.device)
        next_gate = self.track.next_gate(stations).to(self.device)
        return State(pose, next_gate, torch.zeros_like(next_gate))

    def sense(self, pose: Tensor) -> Tensor:
        """Distances to the wall along each ray: poses [B, 3] to [B, R], float32, m, in [0, max_range]."""
        if self._kernels:
            return self._kernels.sense(pose)
        angles = pose[:, 2:].double() + self.sensor_angles.double()  # In float32 this sum alone can cost 0.1 mm.
        return ray_distances(pose[:, :2], angles, self.walls, self.sensor.max_range)

    def step(self, state: State, action: Tensor) -> Outcome:
        """Moves every car by one time step.

        The body is a disc, swept along the straight way of the step, so that no wall is jumped over at any speed.
        A gate counts when the middle of the car crosses it forward and it is the next one in order; nothing else
        counts, so going back and forth over a gate earns nothing, nor does driving the wrong way round.

        Args:
            state: before the step.
            action: values of `Action`, [B], int64.
        """
        if self._kernels:
            *after_step, ranges, collided, passed = self._kernels.step(*state, action)
            return Outcome(State(*after_step), ranges, collided, passed)
        pose = self.vehicle.move(state.pose, action)
        begin, end = state.pose[:, :2], pose[:, :2]
        collided = path_clearance(begin, end, self.walls) < self.vehicle.body_radius
        passed = torch.where(collided, 0, self._count_gates(begin, end, state.next_gate))
        next_gate = (state.next_gate + passed) % len(self.gates)
        after = State(pose, next_gate, state.gates_passed + passed)
        return Outcome(after, self.sense(pose), collided, passed)

    def progress(self, state: State, start_stations: Tensor) -> Tensor:
        """Share of the lap driven since the start, [B], in [0, 1]; the start's stations are [B], m.

        Measured along the centreline, and only as far as the gates passed in order vouch for it.
        """
        start = start_stations.cpu() % self.track.length
        begin = self.track.next_gate(start)
        passed = state.gates_passed.cpu()
        gate_gap = self.track.length / self.track.gate_count
        first_gate = self.track.gate_stations[begin]
        first_gate = torch.where(first_gate <= start, first_gate + self.track.length, first_gate)
        low = torch.where(passed == 0, start, first_gate + (passed - 1) * gate_gap)
        high = first_gate + passed * gate_gap
        station = self.track.station_near(state.pose[:, :2].cpu(), low, high)
        share = (station - start) / self.track.length
        return torch.where(passed >= self.track.gate_count, 1.0, share.clamp(0, 1))

    def _load_kernels(self) -> "Kernels":
        from carrl.sim.kernels import Kernels  # Here, since Numba takes half a second to import.

        most_gates = self._most_gates_per_step
        return Kernels(self.walls, self.gates, self.sensor_angles, self.sensor.max_range, self.vehicle, most_gates)

    def _count_gates(self, begin: Tensor, end: Tensor, next_gate: Tensor) -> Tensor:
        """Gates crossed forward and in order on the straight ways begin-end, [B], int64."""
        passed = torch.zeros_like(next_gate)
        for _ in range(self._most_gates_per_step):
            gate = self.gates[(next_gate + passed) % len(self.gates)]
            passed = passed + _crosses_forward(begin, end, gate)
        return passed


def _crosses_forward(begin: Tensor, end: Tensor, gate: Tensor) -> Tensor:
    """Whether each way begin-end, [B, 2], crosses its own gate (left end, right end), [B, 2, 2], forward: [B]."""
    left, across = gate[:, 0], gate[:, 1] - gate[:, 0]
    side_before, side_after = cross(across, begin - left), cross(across, end - left)
    share = (side_before / (side_before - side_after))[:, None]
    position = ((begin + share * (end - begin) - left) * across).sum(-1) / (across * across).sum(-1)
    return (side_before < 0) & (side_after >= 0) & (position >= 0) & (position <= 1)


def _most_gates_per_step(gates: Tensor, step_length: float) -> int:
    """How many gates [G, 2, 2] the straight way of one step can cross at the most."""
    lines = shapely.linestrings(gates.numpy())
    gap = shapely.distance(lines, np.roll(lines, 1)).min()
    return len(gates) if gap * len(gates) <= step_length else math.floor(step_length / gap) + 1
