"""The fastest speeds of a point mass along a given line, place by place: another way to a lap time.

Shapes: `S` places. Units: m, s.

Source: Heilmeier et al., "Minimum curvature trajectory planning and control for an autonomous race car" (2020),
section 5, for the forward and backward passes.
"""

import numpy as np

from carrl.racing.cross_sections import Floats
from carrl.racing.reference_line import ReferenceLine
from carrl.sim.driven import GRAVITY
from carrl.sim.kinematic import Kinematic
from carrl.sim.single_track import SingleTrack

_PLACES = 4
"""From station to station of the line."""
_LAPS = 2
"""Of both passes, until the profile closes."""


def forward_backward(line: ReferenceLine, car: SingleTrack) -> float:
    """The lap time along a line of a point mass with the grip and the power of a car, s."""
    count = _PLACES * len(line)
    distance, step = np.arange(count) * line.length / count, line.length / count
    closed = line.closed()
    speed = possible_speeds(np.interp(distance, closed.distance, closed.curvature), step, car)
    return float((2 * step / (speed + np.roll(speed, -1))).sum())


def possible_speeds(curvature: Floats, steps: Floats | float, car: SingleTrack | Kinematic) -> Floats:
    """The fastest speeds of a point mass along a closed way, [S], m/s.

    Cornering limits the speed at each place; then braking limits it from place to place backwards, and grip and power
    forwards.

    Args:
        curvature: of the way at each place, [S], 1/m.
        steps: from each place to the next, [S], or everywhere, m.
        car: whose grip, power and brakes it has.
    """
    bends, grip = np.abs(curvature), car.friction * GRAVITY
    ahead = np.broadcast_to(steps, bends.shape)
    back = np.roll(ahead[::-1], -1)
    speed = np.sqrt(grip / bends.clip(grip / car.max_speed**2))
    drive, brakes = car.max_acceleration, getattr(car, "max_braking", car.max_acceleration)
    engine = car if isinstance(car, SingleTrack) else None
    for _ in range(_LAPS):
        speed = _limited(speed, bends, ahead, grip, min(grip, drive), engine)
        speed = _limited(speed[::-1], bends[::-1], back, grip, min(grip, brakes), None)[::-1]
    return speed


def _limited(
    speed: Floats, bends: Floats, steps: Floats, grip: float, strongest: float, engine: SingleTrack | None
) -> Floats:
    """The profile [S] that gains no more from place to place than grip and engine give; None for no engine's limit."""
    limited, curvature, step = speed.tolist(), bends.tolist(), steps.tolist()
    count, first = len(speed), int(speed.argmin())
    for index in range(first, first + count):
        here, after = index % count, (index + 1) % count
        now = limited[here]
        left = 1 - min(curvature[here] * now * now / grip, 1.0) ** 2
        gained = min(strongest, grip * left**0.5)
        if engine is not None:
            gained = min(gained, engine.max_acceleration * engine.power_speed / max(now, engine.power_speed))
        limited[after] = min(limited[after], (now * now + 2 * step[here] * gained) ** 0.5)
    return np.array(limited)
