"""`carrl laps`: laps of one track against each other, as a table, a page, a video or a picture."""

import argparse
import importlib
import json
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from carrl.cli.parser import Parser
from carrl.cli.track_convert import add_reading_flags, load_as_said
from carrl.errors import CarrlError, printable
from carrl.files import check_may_appear

if TYPE_CHECKING:
    from carrl.racing.laps import Lap
    from carrl.tracks.track import Track

WRITERS = {
    ".html": ("carrl.export.laps_page", "write_laps_page"),
    ".mp4": ("carrl.render.laps_video", "write_laps_video"),
    ".gif": ("carrl.render.laps_video", "write_laps_video"),
    ".png": ("carrl.render.laps_figure", "draw_laps"),
    ".pdf": ("carrl.render.laps_figure", "draw_laps"),
    ".svg": ("carrl.render.laps_figure", "draw_laps"),
}
"""Of what `--out` may name by its endings: the module, which may take long to import, and the function."""


def main(argv: list[str]) -> int:
    """Prints the laps' times and writes what was asked for."""
    arguments = _parser().parse_intermixed_args(argv)
    outs = [Path(out) for out in arguments.out]
    for number, out in enumerate(outs):
        if out in outs[:number]:
            raise CarrlError(f"--out is given twice for '{out}'; leave one of them out")
        _check(out, arguments.laps)
    from carrl.evaluation.lap_files import read_laps

    track = load_as_said(arguments)
    laps = read_laps(arguments.laps, track)
    for out in outs:
        _write(out, track, laps)
    if arguments.json:
        print(json.dumps({"track": track.name, "length_m": track.length, "laps": _documents(laps)}, indent=2))
    else:
        _print(track.name, laps)
        for out in outs:
            print(printable(str(out)))
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="carrl laps",
        description="Compares laps of one track: their times and sectors, and by how many seconds each is behind the "
        "first one. --out makes a page that replays them against each other, a video, or a picture.",
    )
    parser.add_argument(
        "track", metavar="NAME|FILE", help="a built-in track, a file, or the name of a file in CARRL_TRACKS"
    )
    parser.add_argument(
        "laps",
        nargs="+",
        metavar="LAP.csv",
        help="from carrl evaluate --speed-trace, or from carrl track lap-time --csv; the first is the reference",
    )
    add_reading_flags(parser)
    parser.add_argument(
        "--out",
        action="append",
        default=[],
        metavar="FILE",
        help="a page (.html), a video (.mp4, .gif) or a picture (.png, .pdf, .svg); may be repeated; an older file is "
        "replaced",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON document and nothing else")
    return parser


def _check(out: Path, sources: Sequence[str]) -> None:
    """Raises CarrlError where a file has no ending that is known, is one of those that are read, or has no place."""
    if out.suffix.lower() not in WRITERS:
        raise CarrlError(f"--out is '{out}'; its name must end in one of: {', '.join(WRITERS)}")
    for source in sources:
        with suppress(OSError, ValueError):  # whoever opens them says what is wrong
            if out.samefile(source):
                raise CarrlError(f"--out is '{out}', a lap that is to be read; choose another name")
    check_may_appear(out)


def _write(out: Path, track: "Track", laps: "Sequence[Lap]") -> None:
    module, function = WRITERS[out.suffix.lower()]
    write = getattr(importlib.import_module(module), function)
    if function != "write_laps_video":
        write(out, track, laps)
        return
    from carrl.cli.text.picture_progress import pictures_drawn

    with pictures_drawn() as drawn:
        write(out, track, laps, drawn)


def _documents(laps: "Sequence[Lap]") -> list[dict[str, Any]]:
    return [
        {
            "name": lap.name,
            "standing": lap.is_standing,
            "lap_time_s": _rounded(lap.lap_time),
            "gap_s": _rounded(_gap(lap, laps[0])),
            "sector_times_s": [_rounded(time) for time in lap.sector_times],
            "least_speed_mps": round(float(lap.speed.min()), 3),
            "greatest_speed_mps": round(float(lap.speed.max()), 3),
            "end_m": round(lap.end[0], 3),
        }
        for lap in laps
    ]


def _gap(lap: "Lap", reference: "Lap") -> float | None:
    """At the end of the lap, s; None where one of the two did not come round."""
    gap = float(lap.gap_to(reference, np.array([lap.length]))[0])
    return None if np.isnan(gap) else gap


def _rounded(seconds: float | None) -> float | None:
    return None if seconds is None else round(seconds, 3)


def _print(track: str, laps: "Sequence[Lap]") -> None:
    from carrl.cli.text.terminal_table import print_table

    print_table(
        f"{track}: {len(laps)} laps, s" if len(laps) > 1 else f"{track}: a lap, s",
        ("lap", "begins", "time", "gap", "S1", "S2", "S3", "speed, m/s"),
        [_row(lap, laps[0]) for lap in laps],
        figures=("time", "gap", "S1", "S2", "S3", "speed, m/s"),
    )


def _row(lap: "Lap", reference: "Lap") -> list[str]:
    gap = _gap(lap, reference)
    return [
        lap.name,
        "from rest" if lap.is_standing else "flying",
        f"ended at {lap.end[0]:,.0f} m" if lap.lap_time is None else f"{lap.lap_time:.2f}",
        "" if lap is reference else "-" if gap is None else f"{gap:+.2f}",
        *("-" if time is None else f"{time:.2f}" for time in lap.sector_times),
        f"{lap.speed.min():.1f} to {lap.speed.max():.1f}",
    ]
