"""When drives come round: lap and sector times, interpolated within the step.

A lap begins and ends at the line across the road where its drive began. Two more lines, after each third of the
centreline, part it into sectors. Lines reach from wall to wall, as gates do, and must be crossed one after the other,
each while the gates about it are passed. The first lap begins with the drive, so in a car whose speed varies from rest.

Shapes: `B` cars, `T` steps, `S` entries of a vehicle's state, `L` lines of all laps, the last of a lap where it ends.
"""

import numpy as np
import torch
from torch import Tensor

from carrl.racing import SECTORS
from carrl.sim.crossing import AT_LINE, Floats, crossing_shares, time_shares
from carrl.sim.simulator import CarState, Simulator

SectorTimes = tuple[tuple[float, ...], ...]
"""Of each lap that was begun, s: those of its sectors that were completed, and none of a lap before the last one is
missing."""


class LapTiming:
    """The lines of some drives.

    Args:
        simulator: of the drives.
        cars: at their starts, [B].
        stations: of the starts, m along the centreline, [B].
        laps: how many are driven.
        behind: the line by how much each car starts, whose first lap is longer by that, less than a lap, [B], m; 0 by
            default.
    """

    def __init__(
        self, simulator: Simulator, cars: CarState, stations: Tensor, laps: int, behind: Tensor | None = None
    ) -> None:
        """Lays the lines across the road."""
        track = cars.track.cpu()
        self._vehicle, self._laps = simulator.vehicle, laps
        length = simulator.routes.lengths[track]
        start, gap = stations.cpu() % length, length / simulator.gate_counts.cpu()[track]
        first_gate = (cars.next_gate.cpu() + 1) * gap
        first_gate = torch.where(first_gate <= start, first_gate + length, first_gate)
        line = start if behind is None else start + behind.cpu()
        places = line[:, None] + length[:, None] * torch.arange(1, laps * SECTORS + 1) / SECTORS
        ends = simulator.routes.walls(track.repeat_interleave(SECTORS), places[:, :SECTORS].flatten())
        self._lines = ends.view(-1, SECTORS, 2, 2).numpy()
        gates_before = ((places - first_gate[:, None]) / gap[:, None]).floor().long().clamp(min=-1) + 1
        self._gates_before = gates_before.numpy()
        last_gate = first_gate + laps * length - gap
        self._goes_on = (last_gate < places[:, -1] - AT_LINE / 2).to(cars.track.device)
        self._has_ended = ~self._goes_on

    def has_ended(self, before: CarState, after: CarState, has_lapped: Tensor) -> Tensor:
        """Whether each car has come to the line of its last lap by the end of this step, [B], bool.

        To be told of every step in turn, and which cars have passed all gates of their laps after it, [B].
        """
        if (has_lapped & self._goes_on).any():
            begin, end = (cars.pose[:, :2].double().cpu().numpy() for cars in (before, after))
            with np.errstate(invalid="ignore"):  # of a car that touched a wall since its place is no number
                crosses = ~np.isnan(crossing_shares(self._lines[:, -1], begin, end))
            self._has_ended |= has_lapped & torch.from_numpy(crosses).to(has_lapped.device)
        return has_lapped & self._has_ended

    def sector_times(self, course: CarState, lengths: Tensor) -> list[SectorTimes]:
        """The times of each car.

        Args:
            course: at the start and after each step, [T + 1, B].
            lengths: after how many steps a car may no longer cross a line, since it touches a wall, or its time is up,
                [B].
        """
        states, passed = course.state.double().cpu().numpy(), course.gates_passed.cpu().numpy()
        limits = lengths.cpu().tolist()
        return [
            self._of_car(car, states[: limit + 1, car], passed[: limit + 1, car]) for car, limit in enumerate(limits)
        ]

    def _of_car(self, car: int, states: Floats, passed: np.ndarray) -> SectorTimes:
        """The times of one car, of its states [T + 1, S] and the gates that it had passed by then, [T + 1]."""
        times = [0.0]
        for line in range(self._laps * SECTORS):
            time = self._crossing_time(car, line, states, passed)
            if time is None:
                break
            times.append(time)
        sectors = np.diff(times).tolist()
        laps = range(0, min(len(sectors) + 1, self._laps * SECTORS), SECTORS)
        return tuple(tuple(sectors[begin : begin + SECTORS]) for begin in laps)

    def _crossing_time(self, car: int, line: int, states: Floats, passed: np.ndarray) -> float | None:
        """When a car crosses one of its lines, s; None where it does not.

        It is looked for from the gate before the last one ahead of the line to the first one behind it: where the two
        stand in the same place, their order is a matter of rounding.
        """
        gates = int(self._gates_before[car, line])
        begin, end = (int(passed.searchsorted(count)) for count in (gates - 1, gates + 1))
        near = states[max(begin - 1, 0) : end + 1]
        shares = crossing_shares(self._lines[car, line % SECTORS], near[:-1, :2], near[1:, :2])
        steps = np.flatnonzero(~np.isnan(shares))
        if not len(steps):
            return None
        step = steps[0]
        share = shares[step]
        if "speed" in self._vehicle.state_names:
            speeds = near[step : step + 2, self._vehicle.state_names.index("speed")]
            share = time_shares(share, speeds[0], speeds[1])
        return float((max(begin - 1, 0) + step + share) * self._vehicle.time_step)
