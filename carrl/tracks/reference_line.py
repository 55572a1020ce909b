"""Pieces of a road's reference line: straights, arcs, spirals and polynomials, and points along them.

Shapes: `P` points of a piece.
"""

import math
from dataclasses import dataclass

import numpy as np

SPACING_MAX, SPACING_OF_POLYNOMIALS, SAGITTA = 5.0, 1.0, 0.003
"""How far points stand apart at the most, along polynomials always, and how far a curve is from the line through its
points, m."""
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)


@dataclass(frozen=True)
class Piece:
    """A piece of a reference line: a line, arc or spiral, or a curve of two polynomials.

    Attributes:
        x: where it begins, m.
        y: likewise.
        heading: there, rad.
        length: m.
        curvatures: 1/m, where it begins and where it ends; they change evenly along it.
        polynomials: of u ahead and v to the left of its beginning, coefficients of rising powers, [2, 4]; or None.
        parameter_end: of the polynomials, at the end of the piece.
    """

    x: float
    y: float
    heading: float
    length: float
    curvatures: tuple[float, float] = (0.0, 0.0)
    polynomials: np.ndarray | None = None
    parameter_end: float = 1.0

    @property
    def steps(self) -> int:
        """Into how many parts of a line it is cut."""
        step = SPACING_MAX if self.polynomials is None else SPACING_OF_POLYNOMIALS
        curvature = max(map(abs, self.curvatures))
        if curvature:
            step = min(step, math.sqrt(8 * SAGITTA / curvature), math.pi / 8 / curvature)
        return max(1, math.ceil(self.length / step))

    @property
    def shares(self) -> np.ndarray:
        """Where the ends of these parts are along it, [P], from 0 to 1."""
        return np.linspace(0, 1, self.steps + 1)

    def poses(self) -> np.ndarray:
        """Places, m, and headings, rad, at its `shares`, [P, 3]."""
        if self.polynomials is not None:
            powers = np.arange(4)
            at = self.shares * self.parameter_end
            u, v = self.polynomials @ at ** powers[:, None]
            du, dv = (self.polynomials * powers)[:, 1:] @ at ** powers[:3, None]
            turned = np.arctan2(dv, du)
        else:
            u, v, turned = self._integrated()
        cos, sin = math.cos(self.heading), math.sin(self.heading)
        return np.stack([self.x + cos * u - sin * v, self.y + sin * u + cos * v, self.heading + turned], axis=1)

    def _integrated(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """How far ahead and to the left, m, and turned by what, rad: by Gauss-Legendre from part to part."""
        begin, end = self.curvatures
        change, step = (end - begin) / self.length, self.length / self.steps

        def turned(at: np.ndarray) -> np.ndarray:
            return at * (begin + at * change / 2)

        along = self.shares * self.length
        headings = turned(along[:-1, None] + step / 2 * (1 + _NODES))
        u, v = (np.concatenate([[0.0], (way(headings) @ _WEIGHTS).cumsum() * step / 2]) for way in (np.cos, np.sin))
        return u, v, turned(along)
