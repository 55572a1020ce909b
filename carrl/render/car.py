"""How a car and its rays are drawn: a disc or a rectangle to scale, whatever kind of picture it is.

Shapes: `R` rays, `K` corners. Lengths in the world are in metres, in the picture in units.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from carrl.log.trace import ray_origins
from carrl.render.canvas import Canvas, Floats, Stroke, View, closed
from carrl.render.colours import Theme
from carrl.render.scene import Style

# A car with its nose to +x, in body radii.
_HULL = np.array([[-0.92, -0.4], [-0.92, 0.4], [0.45, 0.42], [0.95, 0.2], [0.95, -0.2], [0.45, -0.42]])
_SCREEN = np.array([[-0.05, -0.3], [-0.05, 0.3], [0.3, 0.24], [0.3, -0.24]])
_HULL_REACH, _TYRE_REACH = 0.95, 0.59
"""How far ahead the hull reaches, and to the side the tyres, body radii."""
_NOSE = np.array([[0.45, 1.0], [1.0, 0.0], [0.45, -1.0]])
"""Of a rectangle, in halves of its length and width."""
_TYRE = np.array([[-0.22, -0.11], [-0.22, 0.11], [0.22, 0.11], [0.22, -0.11]])
_AXLES = ((-0.55, -0.48), (-0.55, 0.48), (0.5, -0.48), (0.5, 0.48))
_WHEEL_ANGLE = 0.45
"""Of the front wheels turned fully, rad."""


def wheel_turn(steering: float) -> float:
    """How far `draw_car` is to turn front wheels that stand at this angle, rad."""
    return steering / _WHEEL_ANGLE


def draw_rays(
    canvas: Canvas, view: View, origin: Floats, ends: Floats, colours: Sequence[str], hits: ArrayLike, style: Style
) -> None:
    """Lines from the car [2] to where its rays end [R, 2], with a dot where one meets a wall."""
    begin, radius, places = view.places(origin), style.ray_end.width(view), view.places(ends)
    looks = list(zip(colours, np.asarray(hits).tolist(), strict=True))
    for colour, hit in dict.fromkeys(looks):
        alike, stroke = places[[look == (colour, hit) for look in looks]], style.ray.stroke(colour, view)
        canvas.segments(np.stack([np.broadcast_to(begin, alike.shape), alike], axis=1), stroke)
        if hit or style.detailed:
            canvas.discs(alike, radius, colour if hit else None, stroke)


def draw_car(
    canvas: Canvas,
    view: View,
    pose: Floats,
    body_radius: float,
    style: Style,
    *,
    body_size: tuple[float, float] | None = None,
    steer: float = 0.0,
    collided: bool = False,
    is_other: bool = False,
) -> None:
    """The car at a pose [3], its front wheels turned by -1, to the right, to 1, to the left.

    It is a disc of this radius, or a rectangle of this length and width, m; in a colour of its own where it is another
    car of the world.
    """
    theme, middle = style.theme, view.places(pose[:2])
    own = theme.other_car if is_other else theme.car
    colour, edge = theme.crash if collided else own, Stroke(theme.tyre, style.outline.width(view))
    if body_size is not None:
        _draw_rectangle(canvas, view, pose, np.array(body_size) / 2, style, colour, steer)
        return
    radius = max(body_radius * view.scale, style.least_radius)
    if not style.detailed:
        canvas.disc(middle, radius, colour, edge)
        canvas.line([middle, middle + radius * np.array([np.cos(pose[2]), -np.sin(pose[2])])], edge)
        return
    canvas.disc(middle, radius, None, Stroke(colour, edge.width))
    in_metres = radius / view.scale
    _draw_hull(canvas, view, pose, np.array([in_metres, in_metres]), theme, colour, steer)


def draw_others(
    canvas: Canvas,
    view: View,
    poses: Sequence[Floats] | Floats,
    body_radius: float,
    style: Style,
    body_size: tuple[float, float] | None,
) -> None:
    """The other cars of the world at their poses [M, 3]."""
    for pose in poses:
        draw_car(canvas, view, pose, body_radius, style, body_size=body_size, is_other=True)


def _draw_rectangle(
    canvas: Canvas, view: View, pose: Floats, halves: Floats, style: Style, colour: str, steer: float
) -> None:
    """A car of this half length and half width [2], m, with its nose marked; larger if that is too small to see."""
    halves = halves * max(1.0, style.least_radius / (halves[0] * view.scale))
    corners = view.places(placed(np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]]) * halves, pose))
    edge = Stroke(style.theme.tyre, style.outline.width(view))
    if not style.detailed:
        canvas.area([corners], colour, edge)
        canvas.area([view.places(placed(_NOSE * halves, pose))], style.theme.tyre)
        return
    canvas.path(closed([corners]), Stroke(colour, edge.width))
    _draw_hull(canvas, view, pose, halves / (_HULL_REACH, _TYRE_REACH), style.theme, colour, steer)


def _draw_hull(canvas: Canvas, view: View, pose: Floats, size: Floats, theme: Theme, colour: str, steer: float) -> None:
    """Tyres, hull and windscreen, whose shapes are so many metres long and wide for each body radius, [2]."""
    tyres = [placed(_TYRE, np.array([x, y, _WHEEL_ANGLE * steer * (x > 0)])) for x, y in _AXLES]
    parts = ((tyres, theme.tyre), ([_HULL], colour), ([_SCREEN], theme.tyre))
    for shapes, fill in parts:
        canvas.area([view.places(placed(size * shape, pose)) for shape in shapes], fill)


def placed(shape: Floats, pose: Floats) -> Floats:
    """A shape with its nose to +x, [K, 2], m, at a pose [3]."""
    sine, cosine = np.sin(pose[2]), np.cos(pose[2])
    return np.asarray(shape @ np.array([[cosine, sine], [-sine, cosine]]) + pose[:2])


def ray_ends(pose: Floats, ranges: Floats, sensor_angles: Floats, mount: float = 0.0) -> Floats:
    """Where rays with these ranges [..., R] end: [..., R, 2], m; poses [..., 3] and mount are as in `ray_origins`."""
    angles = pose[..., 2:] + sensor_angles
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return np.asarray(ray_origins(pose, mount)[..., None, :] + ranges[..., None] * directions)
