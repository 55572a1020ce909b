"""What happens between a car and the others of its world in a drive: places won and lost, and contacts by fault.

Shapes: `B` cars, `M` others of each, `T` steps.
"""

from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from carrl.rows import Rows
from carrl.sim.others import CarContact
from carrl.sim.simulator import CarState, Outcome, Simulator
from carrl.task.traffic import lead, places_changed


@dataclass
class Passing(Rows):
    """What a step brought, [B], int64; of several steps [T, B].

    Attributes:
        won: places.
        lost: places.
        own: contacts in which the car drove with its front into another one.
        others: all other contacts.
    """

    won: Tensor
    lost: Tensor
    own: Tensor
    others: Tensor

    @classmethod
    def none(cls, cars: CarState) -> "Passing":
        """As before the first step."""
        return cls(*(torch.zeros_like(cars.next_gate) for _ in range(4)))

    def measures(self, lap_share: float) -> dict[str, Any]:
        """The figures of the steps [T] of one car, which are of so much of a lap."""
        won, lost, own, others = (int(values.sum()) for values in (self.won, self.lost, self.own, self.others))
        return {
            "overtakes": won,
            "places_won": won - lost,
            "contacts_own": own,
            "contacts_others": others,
            "lap_share": lap_share,
        }


class ContactCounter:
    """Counts contacts of cars from step to step; those that stay in touch count once.

    Args:
        cars: before the first step, [B].
    """

    def __init__(self, cars: CarState) -> None:
        self._touched = torch.full_like(cars.next_gate, -1)

    def step(self, contact: CarContact) -> tuple[Tensor, Tensor]:
        """Contacts in which each car drove with its front into another one, and all others: [B] both, int64."""
        is_new = contact.touched & (contact.other != self._touched)
        self._touched = contact.other
        return (is_new & contact.at_fault).long(), (is_new & ~contact.at_fault).long()


class PassingCounter:
    """Follows cars and their others from step to step.

    Args:
        simulator: of the drives.
        cars: at their starts, [B], with the others.
    """

    def __init__(self, simulator: Simulator, cars: CarState) -> None:
        self._simulator = simulator
        self._lengths = simulator.routes.lengths.to(cars.track.device)[cars.track].float()
        self._station = simulator.place(replace(cars, station=None)).station
        self._lead = self._leads(cars)
        self._contacts = ContactCounter(cars)

    def step(self, outcome: Outcome) -> Passing:
        """What this step brought."""
        contact, cars, before = outcome.contact, replace(outcome.cars, station=self._station), self._lead
        assert contact is not None
        self._station = self._simulator.place(cars).station
        self._lead = self._leads(outcome.cars)
        won, lost = places_changed(before, self._lead, self._lengths)
        return Passing(won, lost, *self._contacts.step(contact))

    def _leads(self, cars: CarState) -> Tensor:
        """By how much the others are ahead, [B, M], m."""
        assert cars.others is not None
        return lead(replace(cars, station=self._station), cars.others, self._lengths[:, None])
