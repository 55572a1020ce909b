"""Opponents that drive by their own rays and the hand-written rule, slower than they could.

Shapes: `B` worlds, `M` opponents of each.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from carrl.evaluation.baselines import rule_for
from carrl.evaluation.rollout import Policy
from carrl.opponents.pace import check_pace, drawn_pace, opponents_of, paces_of
from carrl.opponents.put_back import put_back
from carrl.sim.others import Others
from carrl.sim.simulator import CarState
from carrl.sim.traffic import Opponents, Traffic
from carrl.sim.vehicle import ConstantSpeed
from carrl.task.action import ActionMap


class Rule(NamedTuple):
    """What the opponents do with what they see.

    Attributes:
        action: what they choose among.
        policy: what they choose.
    """

    action: ActionMap
    policy: Policy


@dataclass(frozen=True)
class RuleOpponents(Opponents):
    """Steer to the side whose rays are longer in sum, those that meet cars among them.

    One that touches a wall is put back on the middle of the road beside that place, and at rest.

    Attributes:
        pace: share of the speed that the rule would drive.
        spread: by how much an opponent's pace may be more or less, drawn for each episode.
    """

    pace: float = 0.7
    spread: float = 0.1

    def __post_init__(self) -> None:
        """Raises ConfigError for a share out of its range."""
        check_pace(self.pace, self.spread)

    def prepare(self, traffic: Traffic) -> Rule:
        """The rule for the vehicle.

        Raises:
            ConfigError: it knows no such car.
        """
        _, action, policy = rule_for(traffic.vehicle, traffic.sensor)
        return Rule(action, policy)

    def begin(self, traffic: Traffic, others: Others, draws: Tensor, track: Tensor) -> Others:
        """With a pace of their own."""
        return replace(others, pace=drawn_pace(self.pace, self.spread, draws[..., 0]).to(others.state.device))

    def drive(self, traffic: Traffic, cars: CarState) -> Others:
        """By the rule, as if they were told to be slower than they are."""
        others = opponents_of(cars)
        track = cars.track[:, None].expand_as(others.next_gate)
        flat = CarState(others.state, others.next_gate, others.gates_passed, track, others.station)
        flat = flat.map(lambda values: values.flatten(0, 1))
        pace, vehicle = paces_of(others).flatten(), traffic.vehicle
        seen = traffic.sensor.readings(traffic.look_back(cars))
        rule: Rule = traffic.prepared
        if isinstance(vehicle, ConstantSpeed):
            after = vehicle.step_at(flat.state, rule.action.controls(rule.policy(seen)), pace)
        else:
            speed = flat.state[:, vehicle.state_names.index("speed")] / pace
            control = rule.action.controls(rule.policy(torch.cat([seen, speed[:, None]], dim=-1)))
            if "speed" in vehicle.control_names:
                index = vehicle.control_names.index("speed")
                control[:, index] = control[:, index] * pace
            after = vehicle.step(flat.state, control)
        outcome = traffic.follow(flat, after)
        after = put_back(traffic, flat, after, outcome.collided)
        station = traffic.place(replace(flat, state=after)).station
        return replace(others, state=after.view_as(others.state), station=station.view_as(others.station))
