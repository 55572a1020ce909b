"""The best lap that a track and a car allow, searched for in the simulator: a mark to measure learnt policies by.

Shapes: `B` drives that the search carries on side by side.
"""

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from carrl.errors import ConfigError, TrackError
from carrl.evaluation.results import Rollout
from carrl.evaluation.rollout import TIME_LIMIT_LAPS, rollout_laps
from carrl.rows import Rows
from carrl.sim.simulator import CarState, Simulator
from carrl.task.action import DiscreteActions
from carrl.task.task import World

_TURN, _SWITCH, _STEP = 2**40, 2**20, 1
"""What each adds to a cost: digits of one number, so that costs compare as (turns, switches, steps) do."""
_NEVER = 2**62
_MEMORY_SLOTS = 2**22 - 3
"""A prime number, so that places spread evenly over the slots."""


def find_best_lap(world: World, bin_size: float = 0.25) -> Rollout:
    """The lap from the start line with the fewest turns, then the fewest switches, then the fewest steps.

    Only laps without a collision and without a step near a wall count. A turn is a step with the action left or
    right; a switch is a change of action from one step to the next.

    The search carries all drives on by a step at a time, and of those that came to the same place, now or earlier,
    keeps the cheapest. One thing is not exact: the same place means the same exact heading and the same gates passed,
    but only the same square of `bin_size`. So the lap returned is real, while a better one that differs from a
    cheaper drive by less than a square may be missed; halve `bin_size` to see what that is worth.

    Args:
        world: the track, the first of those to learn on, the car, its sensor, and which steps are near a wall.
        bin_size: side of the squares, m. Half of it takes three to five times as long.

    Returns:
        The lap as `evaluation.drive` measures it when the actions found are driven again.

    Raises:
        ConfigError: `bin_size` is outside its range, or the car does more than steer straight on, left and right.
        TrackError: no lap was found within the time limit of `evaluation.drive`.
    """
    world = replace(world, opponents=None)
    simulator = world.simulator(world.track)
    steers = _steers(world)
    largest = simulator.vehicle.step_length / math.sqrt(2)
    if not 0 < bin_size <= largest:
        raise ConfigError(
            f"bin_size is {bin_size}; it must be positive and at most {largest:.3g} m, "
            "so that every step leads to another square"
        )
    actions = _Search(world, simulator, steers, bin_size).run()
    if actions is None:
        raise TrackError(
            f"track '{simulator.track.name}': found no lap without a collision or a step near a wall; "
            "use a wider track, a car that turns more tightly, or a smaller bin_size"
        )
    playback = iter(actions)
    (lap,) = rollout_laps(
        world, simulator, lambda observation: torch.tensor([next(playback)], device=observation.device)
    )
    return lap


def _steers(world: World) -> Tensor:
    """What each action does to the wheel, [A], int64: 1 left, 0 straight on, -1 right.

    Raises:
        ConfigError: an action does anything else, or the car has other controls or a state beyond its pose.
    """
    action, vehicle = world.action, world.vehicle
    if isinstance(action, DiscreteActions) and vehicle.control_names == ("steer",) and len(vehicle.state_names) == 3:
        steers = torch.tensor(action.settings["steer"])
        if torch.isin(steers, torch.tensor([-1.0, 0.0, 1.0])).all():
            return steers.long()
    raise ConfigError("the best lap is searched for among full left, straight on and full right at a constant speed")


@dataclass
class _Front(Rows):
    """Drives of the same number of steps.

    Attributes:
        cars: where they have come to.
        left_turns: less the right turns, [B], int64: the heading without rounding.
        action: the last one, [B], int64; -1 before the first.
        cost: of all steps, [B], int64.
        parent: index of the same drive, without the last step, in the front before, [B], int64.
    """

    cars: CarState
    left_turns: Tensor
    action: Tensor
    cost: Tensor
    parent: Tensor


class _Search:
    """The search and its memory of places; the arguments are those of `find_best_lap` and what comes of them."""

    def __init__(self, world: World, simulator: Simulator, steers: Tensor, bin_size: float) -> None:
        self.world, self.simulator, self.bin_size = world, simulator, bin_size
        self.steers = steers.to(simulator.device)
        self.step_limit = round(TIME_LIMIT_LAPS * simulator.lap_steps)
        # A hash table: each slot holds a place and its cheapest cost for each last action. A new place takes over the
        # slot of another one; what is forgotten is searched again, so this costs time only.
        self.places = torch.full((_MEMORY_SLOTS,), -1, device=simulator.device)
        self.costs = torch.full((_MEMORY_SLOTS, len(self.steers)), _NEVER, device=simulator.device)

    def run(self) -> list[int] | None:
        """The actions of the best lap, if there is one."""
        cars = self.simulator.start(torch.zeros(1, dtype=torch.float64))
        zero = torch.zeros_like(cars.gates_passed)
        front = _Front(cars, left_turns=zero, action=zero - 1, cost=zero, parent=zero)
        history: list[tuple[Tensor, Tensor]] = []
        best_cost, best_index, best_steps = _NEVER, 0, 0
        while len(history) < self.step_limit and len(front.cost):
            front = self._expand(front)
            # This ends completed laps too: one step more costs more than the lap.
            front = self._keep_cheapest(front[front.cost < best_cost])
            history.append((front.parent.int(), front.action.to(torch.int8)))
            completed = self.simulator.has_lapped(front.cars)
            for index in completed.nonzero()[:, 0].tolist():
                if front.cost[index] < best_cost:
                    best_cost, best_index, best_steps = int(front.cost[index]), index, len(history)
        actions = []
        for parents, last_actions in reversed(history[:best_steps]):
            actions.append(int(last_actions[best_index]))
            best_index = int(parents[best_index])
        return actions[::-1] or None

    def _expand(self, front: _Front) -> _Front:
        """All drives one step further that neither collide nor come near a wall."""
        parent = torch.arange(len(front.cost), device=self.simulator.device).repeat(len(self.steers))
        before = front[parent]
        action = torch.arange(len(self.steers), device=parent.device).repeat_interleave(len(front.cost))
        steer = self.steers[action]
        outcome = self.simulator.step(before.cars, self.world.action.controls(action))
        near_wall = self.world.reward.near_wall.is_near_wall(self.simulator.sensor.readings(outcome.ranges))
        switched = (before.action >= 0) & (before.action != action)
        cost = before.cost + _TURN * (steer != 0) + _SWITCH * switched + _STEP
        left_turns = before.left_turns + steer
        return _Front(outcome.cars, left_turns, action, cost, parent)[~outcome.collided & ~near_wall]

    def _keep_cheapest(self, front: _Front) -> _Front:
        """The drives that no other one makes needless, of those in this front and in all fronts before."""
        place = self._place(front)
        way = place * len(self.steers) + front.action
        index = front.cost.argsort(stable=True)
        index = index[way[index].argsort(stable=True)]
        is_first = torch.ones_like(index, dtype=torch.bool)
        is_first[1:] = way[index].diff() != 0
        index = index[is_first]
        front, place = front[index], place[index]

        slot = place % _MEMORY_SLOTS
        self.costs[slot[self.places[slot] != place]] = _NEVER
        self.places[slot] = place
        is_known = self.places[slot] == place  # Of two new places for one slot, one loses.
        entry = (slot * len(self.steers) + front.action)[is_known]
        self.costs.view(-1).scatter_reduce_(0, entry, front.cost[is_known], "amin")
        known = torch.where(is_known[:, None], self.costs[slot], _NEVER)
        is_cheapest = front.cost <= known.gather(1, front.action[:, None])[:, 0]
        # A drive of another last action can go on as this one does, for at most one switch more.
        return front[is_cheapest & (front.cost < known.amin(dim=1) + _SWITCH)]

    def _place(self, front: _Front) -> Tensor:
        """A number for each combination of square, heading and gates passed, [B], int64."""
        corners = self.simulator.track.walls.flatten(0, 1).double().to(self.simulator.device)
        low, high = corners.amin(0), corners.amax(0)
        column, row = ((front.cars.state[:, :2] - low) / self.bin_size).long().unbind(1)
        square = column * (int((high - low)[1] / self.bin_size) + 1) + row
        heading = square * (2 * self.step_limit + 1) + self.step_limit + front.left_turns
        return heading * 2 * self.simulator.track.gate_count + front.cars.gates_passed
