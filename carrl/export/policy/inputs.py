"""What an exported policy is told, by name and in physical units, and how an observation is made of it.

Shapes: `B` cars, `R` rays, `A` discrete actions, `C` controls.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from carrl.log.scene import STATE_UNITS
from carrl.sim.sensor import Sensor
from carrl.task.action import ActionMap
from carrl.task.motion import LastControl, StateEntry, Velocity, WallContact
from carrl.task.observation import LastAction, Observation, ObservationTerm, Rays, Scans
from carrl.task.road import Curvatures, HeadingError, TrackPosition

FLOAT, INDEX = "float32", "int64"
MEANINGS = {
    "speed": "of the car's centre of gravity",
    "slip": "the direction of the velocity against the heading, left positive",
    "yaw_rate": "how fast the car turns, left positive",
    "steering": "angle of the front wheels, left positive",
    "acceleration": "along the heading, a mean over the last control period",
    "lateral_acceleration": "to the left of the heading, a mean over the last control period",
}


@dataclass(frozen=True)
class Input:
    """One input.

    Attributes:
        name: of it.
        shape: of one car's values, without B.
        unit: of them; 1 for plain numbers.
        meaning: in a few words.
        dtype: float32, or int64 for the number of an action.
    """

    name: str
    shape: tuple[int, ...]
    unit: str
    meaning: str
    dtype: str = FLOAT

    def document(self) -> dict[str, Any]:
        """For JSON."""
        return {**vars(self), "shape": list(self.shape)}


@dataclass(frozen=True)
class Reading:
    """A stretch of the observation.

    Attributes:
        inputs: that it is made of.
        document: how, for JSON: the `kind`, one of `carrl.export.policy.graph.READINGS`, and what else that needs.
    """

    inputs: tuple[Input, ...]
    document: Mapping[str, Any]


def state_input(entry: str) -> Input:
    """The input for an entry of a vehicle's state."""
    meaning = MEANINGS.get(entry, "entry of the vehicle's state")
    return Input(entry, (), STATE_UNITS.get(entry, "1").replace("²", "^2"), meaning)


def last_action_input(action: ActionMap) -> Input:
    """The input for the action of the step before."""
    if action.names:
        meaning = f"number of the action of the step before; at a start 0, {action.names[0]}"
        return Input("last_action", (), "1", meaning, INDEX)
    shape = (len(action.control_names),)
    return Input("last_action", shape, "1", "the output action of the step before; at a start zeros")


def readings_of(observation: Observation, sensor: Sensor, action: ActionMap) -> tuple[Reading, ...]:
    """How each term of an observation is made of inputs, in its order.

    A term that is not CarRL's has an input of its own name, for its values as it gives them.
    """
    return tuple(_reading(name, term, sensor, action) for name, term in observation.terms.items())


def merged(inputs: Iterable[Input]) -> tuple[Input, ...]:
    """Each input once, the rays first; of inputs of one name that with the most values, whose first ones others use."""
    found: dict[str, Input] = {}
    for each in inputs:
        known = found.get(each.name)
        found[each.name] = each if known is None or each.shape > known.shape else known
    first = ("rays", "previous_rays")
    return tuple(sorted(found.values(), key=lambda each: first.index(each.name) if each.name in first else len(first)))


def _reading(name: str, term: ObservationTerm, sensor: Sensor, action: ActionMap) -> Reading:
    rays = Input(
        "rays", (sensor.rays,), "m", "distance along each ray, right to left; inf or nan where there is no echo"
    )
    kind = type(term)  # a class derived from one of these may do anything
    if kind is Rays:
        return _scans(rays, 1, sensor)
    if kind is Scans:
        return _scans(rays, term.count, sensor)  # type: ignore[attr-defined]
    if isinstance(term, StateEntry) and kind is StateEntry:
        return _scaled(state_input(term.entry), divisor=term.unit)
    if isinstance(term, Velocity) and kind is Velocity:
        inputs = state_input("speed"), state_input("slip")
        return Reading(inputs, {"kind": "velocity", "divisor": float(term.unit)})
    if kind is LastAction:
        given = last_action_input(action)
        return Reading((given,), {"kind": "one_hot"}) if action.names else _scaled(given)
    if isinstance(term, LastControl) and kind is LastControl:
        index = list(action.control_names).index(term.control)
        return Reading((last_action_input(action),), {"kind": "last_control", "index": index})
    if kind is WallContact:
        return _scaled(Input("contact", (), "1", "1 if the car touched a wall in the last control period, else 0"))
    if isinstance(term, HeadingError) and kind is HeadingError:
        meaning = "the heading against the direction of the centreline, left positive"
        return _scaled(Input("heading_error", (), "rad", meaning), divisor=term.unit)
    if kind is TrackPosition:
        return _scaled(Input("track_position", (), "1", "-1 at the right edge of the road, 1 at the left one"))
    if isinstance(term, Curvatures) and kind is Curvatures:
        meaning = (
            f"of the centreline, left positive, where the car is at its present speed after {term.from_s:g} s, and "
            f"every {term.spacing_s:g} s from there"
        )
        return _scaled(Input("curvatures", (term.count,), "1/m", meaning), factor=term.radius)
    width = term.part(name, sensor, action).width
    return _scaled(Input(name, (width,), "1", "values of the observation's term of this name, as it gives them"))


def _scaled(given: Input, divisor: float = 1.0, factor: float = 1.0) -> Reading:
    way = {"kind": "scaled", "input": given.name, "divisor": float(divisor), "factor": float(factor)}
    return Reading((given,), way)


def _scans(rays: Input, count: int, sensor: Sensor) -> Reading:
    way = {"kind": "rays", "count": count, "max_range": float(sensor.max_range)}
    if count == 1:
        return Reading((rays,), way)
    meaning = "the scans before, the newest first; at a start copies of the first one"
    return Reading((rays, Input("previous_rays", (count - 1, sensor.rays), "m", meaning)), way)
