"""The lap as a nonlinear programme: direct transcription from station to station by the implicit midpoint rule.

The unknowns at a station are the offset from the middle of the road along the line across it, the heading against the
road's, and the rest of the model's motion; between two stations they are the controls and the time. Places are
Cartesian, so that nothing depends on the curvature of some line.

Shapes: `N` stations, `S` states, `C` controls, `P` points of a side of the body. Units: m, s, rad.
"""

import time
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from carrl.errors import CarrlError
from carrl.racing.cross_sections import CrossSections, Floats
from carrl.racing.equations import casadi
from carrl.racing.models import MOST_TURN, LapModel

MOST_ITERATIONS = 1500
TOLERANCE = 1e-6
"""Of IPOPT, of scaled quantities."""
SMOOTHING = 1e-3
"""Of the lap's time, for a control that is always at its limit."""
_TURN_SCALE = 0.2
_LEAST_STEP, _MOST_STEP = 1e-3, 1e3
"""Of the time between two stations, in what it takes at half of full speed."""
_OPTIONS: dict[str, Any] = {
    "print_time": False,
    "expand": True,  # one list of operations: seconds to build, and an eighth of the time for each second derivative
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.max_iter": MOST_ITERATIONS,
    "ipopt.mu_strategy": "monotone",
    "ipopt.tol": TOLERANCE,
}


class Unknowns(NamedTuple):
    """A lap, or a guess of one.

    Attributes:
        states: offset to the left of the middle, m, heading against the road's, rad, and the model's own, [N, S].
        controls: from each station to the next, [N, C].
        times: from each station to the next, [N], s.
    """

    states: Floats
    controls: Floats
    times: Floats


@dataclass(frozen=True)
class Solution:
    """The fastest lap that was found.

    Attributes:
        unknowns: of it.
        iterations: of IPOPT.
        seconds: of CPU time that it took.
    """

    unknowns: Unknowns
    iterations: int
    seconds: float

    @property
    def lap_time(self) -> float:
        """The sum of the times, s."""
        return float(self.unknowns.times.sum())


class LapProblem:
    """The fastest lap of a model on a road.

    Args:
        model: what moves.
        sections: of the road.
        margin: how much further off the walls than it must be the body stays, m.
    """

    def __init__(self, model: LapModel, sections: CrossSections, margin: float = 0.0) -> None:
        """Builds the programme."""
        self.model, self.sections = model, sections
        half_width, fast = float(sections.width.mean()) / 2, model.car.max_speed
        self._state_scale = np.array([half_width, _TURN_SCALE, *(each.scale for each in model.states)])
        self._control_scale = np.array([each.scale for each in model.controls])
        self._time_scale = sections.spacing / (fast / 2)
        self.margin = margin
        self._build()

    def solve(self, start: Unknowns, warm: bool = False) -> Solution:
        """The fastest lap near a guess.

        Args:
            start: the guess.
            warm: whether it is nearly the solution, as one from a coarser grid is.

        Raises:
            CarrlError: none was found.
        """
        ca, began = casadi(), time.process_time()
        options = {**_OPTIONS, "ipopt.mu_init": 1e-4 if warm else 0.1}
        solver = ca.nlpsol("lap", "ipopt", self._programme, options)
        found = solver(x0=self._packed(start), **self._bounds)
        stats = solver.stats()
        if not stats["success"]:
            raise CarrlError(
                f"no minimum lap was found: IPOPT ended with {stats['return_status']} after {stats['iter_count']} "
                "iterations; try another --spacing"
            )
        unknowns = self._unpacked(np.array(found["x"]).ravel())
        return Solution(unknowns, int(stats["iter_count"]), time.process_time() - began)

    def clearances(self, unknowns: Unknowns) -> Floats:
        """How far each point of the body is inside of the walls, left ones first, [N, 2P], m."""
        scaled = (unknowns.states / self._state_scale).T
        return np.array(self._rooms(scaled)).T * self._state_scale[0]

    def _build(self) -> None:
        """The programme, and bounds of its unknowns and constraints."""
        ca, count = casadi(), len(self.sections.stations)
        states = ca.MX.sym("states", len(self._state_scale), count)
        controls = ca.MX.sym("controls", len(self._control_scale) + 1, count)
        ahead = ca.horzcat(states[:, 1:], states[:, 0])
        columns, columns_after = self.sections.columns, self.sections.columns_after
        gap, limit = self._dynamics().map(count)(states, controls, ahead, columns, columns_after)
        space = self._rooms(states)
        times = self._time_scale * controls[-1, :]
        cost, smoothed = ca.sum2(times), self.model.smoothed
        if smoothed is not None:
            cost = cost + SMOOTHING * ca.sum2(controls[smoothed, :] ** 2 * times)
        self._programme = {
            "x": ca.vertcat(ca.vec(states), ca.vec(controls)),
            "f": cost,
            "g": ca.vertcat(ca.vec(gap), ca.vec(limit), ca.vec(space)),
        }
        sizes = [gap.numel(), limit.numel(), space.numel()]
        low = np.repeat([0.0, -np.inf, self.margin / self._state_scale[0]], sizes)
        self._bounds = {**self._box(), "lbg": low, "ubg": np.repeat([0.0, 0.0, np.inf], sizes)}

    def _dynamics(self) -> Any:
        """From a station to the next: what must be 0 that the motion follows its rates, and the model's limits."""
        ca, model = casadi(), self.model
        state, after = (ca.SX.sym(name, len(self._state_scale)) for name in ("state", "after"))
        control = ca.SX.sym("control", len(self._control_scale) + 1)
        section, section_after = ca.SX.sym("section", 5), ca.SX.sym("section_after", 5)
        begin, end = self._motion(state, section), self._motion(after, section_after)
        middle = [(first + second) / 2 for first, second in zip(begin, end, strict=True)]
        given, step = ca.vertsplit(control[:-1] * self._control_scale), control[-1] * self._time_scale
        gaps = [
            (second - first - step * rate) / scale
            for first, second, rate, scale in zip(
                begin, end, model.rates(middle, given), self._gap_scales(), strict=True
            )
        ]
        limits = model.limits(begin, middle, given)
        arguments = [state, control, after, section, section_after]
        return ca.Function("dynamics", arguments, [ca.vertcat(*gaps), ca.vertcat(*limits)])

    def _rooms(self, states: Any) -> Any:
        """How far each point of the body is inside of the walls, of scaled states [S, N]: [2P, N], scaled."""
        ca, count = casadi(), len(self.sections.stations)
        state, section = ca.SX.sym("state", len(self._state_scale)), ca.SX.sym("section", 5)
        walls = ca.SX.sym("left", 7), ca.SX.sym("right", 7)
        room = ca.Function(
            "room", [state, section, *walls], [ca.vertcat(*self._room(self._motion(state, section), walls))]
        )
        return room.map(count)(states, self.sections.columns, *(wall.columns for wall in self.sections.walls()))

    def _motion(self, state: Any, section: Any) -> list[Any]:
        """x, y, heading and the rest, of a scaled state at a section."""
        own = casadi().vertsplit(state * self._state_scale)
        return [section[0] + own[0] * section[2], section[1] + own[0] * section[3], section[4] + own[1], *own[2:]]

    def _gap_scales(self) -> list[float]:
        spacing = self.sections.spacing
        return [spacing, spacing, _TURN_SCALE / 2, *(each.scale / 5 for each in self.model.states)]

    def _room(self, motion: list[Any], walls: tuple[Any, Any]) -> list[Any]:
        """How far the points of the body are inside of either wall, which is a parabola at each station; scaled."""
        ca, car = casadi(), self.model.car
        x, y, cos, sin = motion[0], motion[1], ca.cos(motion[2]), ca.sin(motion[2])
        rooms = []
        for side, wall in zip((car.width / 2, -car.width / 2), walls, strict=True):
            for ahead in self.model.body:
                away_x, away_y = x + ahead * cos - side * sin - wall[0], y + ahead * sin + side * cos - wall[1]
                along, inside = away_x * wall[2] + away_y * wall[3], away_x * wall[4] + away_y * wall[5]
                rooms.append((inside - wall[6] / 2 * along**2) / self._state_scale[0])
        return rooms

    def _box(self) -> dict[str, Floats]:
        """Bounds of the unknowns, scaled."""
        half, own, controls = self.sections.width / 2, self.model.states, self.model.controls

        def packed(side: float, states: list[float], given: list[float], step: float) -> Floats:
            columns = [side * half, *(np.full(len(half), each) for each in (side * MOST_TURN, *states))]
            control = np.tile(np.array(given), (len(half), 1))
            return self._packed(Unknowns(np.stack(columns, axis=1), control, np.full(len(half), step)))

        steps = _LEAST_STEP * self._time_scale, _MOST_STEP * self._time_scale
        return {
            "lbx": packed(-1, [each.low for each in own], [each.low for each in controls], steps[0]),
            "ubx": packed(1, [each.high for each in own], [each.high for each in controls], steps[1]),
        }

    def _packed(self, unknowns: Unknowns) -> Floats:
        between = np.column_stack([unknowns.controls / self._control_scale, unknowns.times / self._time_scale])
        return np.concatenate([(unknowns.states / self._state_scale).ravel(), between.ravel()])

    def _unpacked(self, values: Floats) -> Unknowns:
        count = len(self.sections.stations)
        states, between = np.split(values, [count * len(self._state_scale)])
        between = between.reshape(count, -1)
        return Unknowns(
            states.reshape(count, -1) * self._state_scale,
            between[:, :-1] * self._control_scale,
            between[:, -1] * self._time_scale,
        )
