"""Laps against each other as a web page: cars on the map, their speeds and gaps over the way; one file, no network.

Shapes: `N` points of the walls, `P` points of the centreline, `G` gates, `T` moments of a lap.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from carrl.export.page import PARTS, assembled, packed
from carrl.files import write_whole
from carrl.racing.laps import Lap
from carrl.render.scene import Ground
from carrl.tracks.track import Track

OWN = Path(__file__).parent
SCRIPTS = (
    *(PARTS / name for name in ("format.js", "theme.js", "brush.js", "camera.js", "road.js", "unpack.js", "plot.js")),
    *(PARTS / name for name in ("player.js", "link.js", "controls.js")),
    *(OWN / name for name in ("race.js", "map.js", "charts.js", "list.js", "main.js")),
)
"""In the order in which they are joined to one script."""
TIME_STEP = 0.05
"""Between two moments of a lap, s; the page goes straight from one to the next."""


def laps_page(track: Track, laps: Sequence[Lap]) -> str:
    """An HTML document that replays laps against each other; of the first one the others' gaps are told.

    Its policy is that of `carrl.export.page.replay_page`.
    """
    title = f"Laps of {track.name}"
    return assembled(OWN / "laps.html", [PARTS / "page.css", OWN / "laps.css"], SCRIPTS, title, _race(track, laps))


def write_laps_page(path: str | Path, track: Track, laps: Sequence[Lap]) -> None:
    """Writes the page to `path`, whole or not at all.

    Raises:
        CarrlError: it cannot be written there.
    """
    write_whole(path, laps_page(track, laps).encode())


def _race(track: Track, laps: Sequence[Lap]) -> dict[str, Any]:
    """What `race.js` reads."""
    ground = Ground.of(track)
    widths = (track.left_wall - track.right_wall).norm(dim=1)
    return {
        "trackName": track.name,
        "trackLength": track.length,
        "roadWidth": widths.mean().item(),
        "bounds": ground.bounds,
        "wallLines": [len(line) for line in ground.walls],
        "timeStep": TIME_STEP,
        "laps": [_lap(lap) for lap in laps],
        "arrays": {
            "wallPoints": packed(np.concatenate(list(ground.walls)), "<f4"),  # [N, 2]
            "centreline": packed(ground.centreline, "<f4"),  # [P, 2]
            "gates": packed(ground.gates[-1:], "<f4"),  # the start line alone, [1, 2, 2]
        },
    }


def _lap(lap: Lap) -> dict[str, Any]:
    end, duration = lap.end
    poses, stations, speeds = lap.at(np.arange(math.ceil(duration / TIME_STEP) + 1) * TIME_STEP)
    return {
        "name": lap.name,
        "standing": lap.is_standing,
        "lapTime": lap.lap_time,
        "sectors": lap.sector_times,
        "end": end,
        "duration": duration,
        "arrays": {
            "poses": packed(poses, "<f4"),  # [T, 3]
            "stations": packed(np.maximum.accumulate(stations).clip(0, end), "<f4"),  # [T]
            "speeds": packed(speeds, "<f4"),  # [T]
        },
    }
