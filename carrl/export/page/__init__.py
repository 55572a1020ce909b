"""One episode as a web page: a single file that replays it in any browser, without a network.

Shapes: `T` steps, `R` rays, `A` actions, `K` terms of the reward, `S` walls, `N` points of the walls, `P` points of the
centreline, `G` gates.
"""

import base64
import hashlib
import html
import json
import re
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from carrl.files import write_whole
from carrl.log.laps import recorded_laps
from carrl.log.scene import STATE_UNITS
from carrl.log.trace import EpisodeTrace
from carrl.render import MOST_SEEN
from carrl.render.colours import LIGHT
from carrl.render.episode import EpisodeScene, connected_walls
from carrl.render.trail import speed_span, steps_of, trail_colours

PARTS = Path(__file__).parent
SCRIPTS = (
    "format.js",
    "theme.js",
    "brush.js",
    "camera.js",
    "road.js",
    "unpack.js",
    "episode.js",
    "car.js",
    "stage.js",
    "plot.js",
    "charts.js",
    "instruments.js",
    "readings.js",
    "player.js",
    "link.js",
    "controls.js",
    "page.js",
)
"""In the order in which they are joined to one script: each uses only what stands before it."""


def replay_page(trace: EpisodeTrace, title: str) -> str:
    """An HTML document that replays the episode, with everything it needs in it.

    Whatever the log says is shown as text. The page's policy allows no script but its own, and nothing to be loaded.

    Args:
        trace: what to replay.
        title: the page's heading.
    """
    scripts = [PARTS / name for name in SCRIPTS]
    return assembled(PARTS / "page.html", [PARTS / "page.css"], scripts, title, _episode(trace))


def assembled(
    page: Path, styles: Sequence[Path], scripts: Sequence[Path], title: str, document: Mapping[str, Any]
) -> str:
    """A page of its parts, with what its script is to read in it.

    Args:
        page: the HTML with a place for each of the others.
        styles: style sheets, in their order.
        scripts: joined to one script, in their order.
        title: the page's heading, shown as text.
        document: what the script reads; arrays are to be `packed`.
    """
    code = "\n".join(_shortened(part) for part in scripts)
    script = f'\n"use strict";\n(async () => {{\n{code}}})();\n'
    style = "\n" + "\n".join(_shortened(part) for part in styles)
    return Template(page.read_text(encoding="utf-8")).substitute(
        policy=_policy(script, style),
        title=html.escape(title).encode("ascii", "xmlcharrefreplace").decode(),
        style=style,
        script=script,
        document=_json_in_html(document),
    )


def write_replay_page(path: str | Path, trace: EpisodeTrace, title: str) -> None:
    """Writes the page to `path`, whole or not at all: a reader sees the old page or the new one.

    Raises:
        CarrlError: it cannot be written there.
    """
    write_whole(path, replay_page(trace, title).encode())


def _shortened(part: Path) -> str:
    """The code of a file without indentation and without the lines that are comments."""
    return re.sub(r"^ *(//.*\n)?", "", part.read_text(encoding="utf-8"), flags=re.MULTILINE)


def _policy(script: str, style: str) -> str:
    """A content security policy under which exactly this script and this style work, and no address is ever asked."""

    def source(text: str) -> str:
        return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"

    rules = {
        "default-src": "'none'",
        "script-src": source(script),
        "style-src": source(style),
        "img-src": "data:",
        "base-uri": "'none'",
        "form-action": "'none'",
    }
    return "; ".join(f"{directive} {sources}" for directive, sources in rules.items())


def _json_in_html(document: Mapping[str, Any]) -> str:
    """JSON in which no character can end the element it stands in, or begin another."""
    text = json.dumps(document, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _episode(trace: EpisodeTrace) -> dict[str, Any]:
    """What `episode.js` reads: names and single numbers as JSON, the rest as arrays."""
    scene, track = trace.scene, trace.track
    lines, drawn = connected_walls(track), EpisodeScene(trace)
    columns = [*drawn.controls, *drawn.columns]
    palette, shades = trail_colours(trace, LIGHT)
    return {
        "episode": trace.episode,
        "car": trace.car,
        "ended": trace.ended,
        "startTime": float(trace.times[0]),
        "timeStep": scene.time_step,
        "actionNames": scene.action_names,
        "hasNamedActions": trace.controls is None,
        "controlNames": [] if trace.controls is None else scene.control_names,
        "termNames": scene.reward_terms,
        "sensorRange": scene.sensor_range,
        "rangeSeen": min(scene.sensor_range, MOST_SEEN),
        "sensorAngles": scene.sensor_angles.tolist(),
        "sensorMount": scene.sensor_mount,
        "bodyRadius": scene.body_radius,
        "bodySize": scene.body_size,
        "friction": scene.friction,
        "speedSpan": None if trace.speeds is None else speed_span(trace.speeds),
        "shadeCount": len(palette),
        "trackName": track.name,
        "trackLength": track.length,
        "bounds": track.bounds,
        "wallLines": [len(line) for line in lines],
        "series": [{"title": _capitalised(series.title), "entries": series.entries} for series in columns],
        "units": STATE_UNITS,
        "gatesBefore": int(trace.gates_passed[0]),  # of the record
        "passings": trace.passings,  # row of the step, index of the gate
        "laps": [[lap.row, round(lap.seconds, 3), lap.counts] for lap in recorded_laps(trace)],
        "arrays": {
            "wallPoints": packed(np.concatenate(lines), "<f4"),  # [N, 2]
            "centreline": packed(track.centreline, "<f4"),  # [P, 2]
            "gates": packed(track.gates, "<f4"),  # [G, 2, 2]
            "stepNumbers": packed(steps_of(trace), "<i4"),  # [T + 1]
            "poses": packed(trace.poses, "<f4"),  # [T + 1, 3]
            "others": packed(trace.others.swapaxes(0, 1), "<f4"),  # [M, T + 1, 3], of the other cars of the world
            "ranges": packed(trace.ranges, "<f4"),  # [T + 1, R]
            "times": packed(trace.times - trace.times[0], "<f4"),  # [T + 1]
            "actions": packed(trace.actions, "|u1"),  # [T]
            "shades": packed(shades, "|u1"),  # [T]
            "exploratory": packed(trace.exploratory, "|u1"),  # [T]
            "rewards": packed(trace.rewards, "<f4"),  # [T]
            "terms": packed(trace.reward_terms, "<f4"),  # [T, K]
            **{f"series{index}": packed(series.values, "<f4") for index, series in enumerate(columns)},  # [T, N]
        },
    }


def _capitalised(title: str) -> str:
    return title[:1].upper() + title[1:]


def packed(values: ArrayLike, kind: str) -> list[str]:
    """For `unpack.js`: the kind of the numbers, and their bytes, row by row, deflated, as base64."""
    return [kind, base64.b64encode(zlib.compress(np.asarray(values).astype(kind).tobytes(), 9)).decode()]
