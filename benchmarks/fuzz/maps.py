"""Maps of ROS, and the files of racelines."""

import io
from random import Random

import numpy as np
import yaml
from PIL import Image

from benchmarks.fuzz.mutation import NUMBERS, mutate
from benchmarks.fuzz.tracks import TrackParser
from benchmarks.fuzz.values import change

_SIDES = (8, 100, 120, 160, 160, 200, 400)
_NAMES = ("s_m", "x_m", "y_m", "psi_rad", "kappa_radpm", "vx_mps", "ax_mps2", "alpha_m", "x_normvec_m", "y_normvec_m")


class TrackMap(TrackParser):
    """`.yaml` beside a picture: a map of ROS."""

    ending = ".yaml"

    def make(self, draw: Random) -> None:
        """A corridor with islands, arms, gaps, specks or shades, its YAML or its picture often damaged."""
        file = io.BytesIO()
        kind = draw.choice(("PNG", "PNG", "PPM", "BMP"))
        Image.fromarray(_picture(draw)).convert(draw.choice(("L", "L", "L", "RGB", "1"))).save(file, kind)
        picture = file.getvalue()
        values = {"image": "map.png", "resolution": draw.choice((0.05, 0.05, 1.0, 1e-3)), "origin": [0, 0, 0]}
        values |= {"negate": 0, "occupied_thresh": 0.65, "free_thresh": draw.choice((0.25, 0.196, 0.0, 0.65))}
        for _ in range(draw.choice((0, 0, 1))):
            values = change(draw, values)
        text = yaml.dump(values).encode()
        (self.folder / "map.png").write_bytes(picture if draw.random() < 0.8 else mutate(draw, picture, [picture]))
        self.path.write_bytes(text if draw.random() < 0.8 else mutate(draw, text, [text]))


def _picture(draw: Random) -> np.ndarray:
    rows, columns = draw.choice(_SIDES), draw.choice(_SIDES)
    y, x = np.mgrid[:rows, :columns] + 0.5
    away = np.hypot((x - columns / 2) / columns, (y - rows / 2) / rows) * min(rows, columns)
    inner = min(rows, columns) * draw.uniform(0.05, 0.4)
    width = draw.choice((0.5, 5, 12, 20, 60))
    cover = np.clip(away - inner + 0.5, 0, 1) * np.clip(inner + width - away + 0.5, 0, 1)
    picture = 254 * (cover if draw.random() < 0.5 else (cover > 0.5))
    shade = np.random.default_rng(draw.randrange(2**32))
    for _ in range(draw.choice((0, 0, 1, 2, 8))):  # islands, arms and gaps
        left, low = draw.randrange(columns), draw.randrange(rows)
        picture[low : low + draw.randint(1, 30), left : left + draw.randint(1, 30)] = draw.choice((0, 205, 254))
    noise = draw.choice((0.0, 0.0, 0.0, 1e-3, 0.1, 0.5))
    picture[shade.random(picture.shape) < noise] = draw.choice((0, 254))
    return picture.astype(np.uint8)


class TrackRaceline(TrackParser):
    """`.csv` of a raceline, alone or beside a centreline."""

    ending = ".csv"

    def make(self, draw: Random) -> None:
        """A table with the columns of TUM's tools, often damaged."""
        count = draw.choice((1, 3, 20, 20, 60))
        angle = 2 * np.pi * np.arange(count) / count
        names = [*_NAMES[:7], "width_right_m", "width_left_m", *_NAMES[7:]] if draw.random() < 0.6 else list(_NAMES)
        table = np.full((count, len(names)), draw.choice((0.0, 1.0, 5.0)))
        table[:, 1:3] = draw.choice((1.0, 50.0)) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        rows = [[f"{value:.6g}" for value in row] for row in table.tolist()]
        for _ in range(draw.choice((0, 0, 1, 2))):
            draw.choice(rows)[draw.randrange(len(names))] = draw.choice(NUMBERS)
        between = draw.choice((";", "; ", ",", "\t"))
        text = "\n".join(["# 8288b625", f"# {between.join(names)}", *map(between.join, rows), ""]).encode()
        self.path.write_bytes(text if draw.random() < 0.4 else mutate(draw, text, [text]))
        (self.folder / "track_raceline.csv").write_bytes(mutate(draw, text, [text]))
