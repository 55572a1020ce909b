"""`carrl track lap-time`: the minimum lap time of a car on a track."""

import argparse
import dataclasses
import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from carrl.cli.track_convert import add_reading_flags, load_as_said
from carrl.errors import ConfigError, TrackError
from carrl.files import check_may_appear
from carrl.tracks.names import check_may_exist

if TYPE_CHECKING:
    from carrl.racing.checks import Check
    from carrl.racing.minimum_lap import MinimumLap
    from carrl.sim.vehicle import VehicleModel
    from carrl.tracks.track import Track

DEFAULT_CAR = "vehicle=single_track"


def add_lap_time_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds what `carrl track lap-time` takes."""
    parser.add_argument(
        "track", metavar="NAME|FILE", help="a built-in track, a file, or the name of a file in CARRL_TRACKS"
    )
    parser.add_argument(
        "overrides",
        nargs="*",
        metavar="vehicle.KEY=VALUE",
        help="the car, as carrl train takes it; default: vehicle=single_track, whose preset is race",
    )
    add_reading_flags(parser)
    parser.add_argument("--quick", action="store_true", help="that of a point mass with the car's grip, in a second")
    parser.add_argument(
        "--spacing",
        type=float,
        metavar="M",
        help="of the stations, m (default: 1.11 lengths of the car, and at least 1,000 stations)",
    )
    parser.add_argument("--margin", type=float, default=0.0, metavar="M", help="that the car keeps to the walls, m")
    parser.add_argument("--check", action="store_true", help="find it in other ways, too; exit code 1 if one differs")
    parser.add_argument("--png", metavar="FILE", help="draw it, as .png, .pdf or .svg; an older picture is replaced")
    parser.add_argument("--csv", metavar="FILE.csv", help="write the line with its speeds and controls")
    parser.add_argument("--force", action="store_true", help="replace a CSV file that is there already")


def run_lap_time(arguments: argparse.Namespace) -> int:
    """Finds it, and returns 1 where a check fails."""
    if "=" not in arguments.track:
        check_may_exist(arguments.track)
    _check_flags(arguments)
    from carrl.racing.checks import check_lap
    from carrl.racing.kept_laps import kept_lap

    arguments.track, vehicle = _track_and_vehicle([arguments.track, *arguments.overrides])
    track = load_as_said(arguments)
    lap = kept_lap(track, vehicle, arguments.spacing, arguments.margin, arguments.quick)
    if arguments.csv is not None:
        lap.line.write(arguments.csv)
    if arguments.png is not None:
        from carrl.render.line_figure import draw_line_figure

        kind = "minimum lap" if lap.model == "single track" else "point mass's minimum lap"
        draw_line_figure(arguments.png, track, lap.line, f"{track.name}: {kind} {lap.lap_time:.2f} s")
    checks = check_lap(track, vehicle, lap) if arguments.check else []
    if arguments.json:
        print(json.dumps(_document(track, vehicle, lap, checks if arguments.check else None), indent=2))
    else:
        _print(track, lap, checks)
    return int(not all(check.passed for check in checks))


def _check_flags(arguments: argparse.Namespace) -> None:
    """Before anything takes long."""
    from carrl.render import picture_format

    if arguments.quick and arguments.check:
        raise ConfigError("--check is for the car's lap, and --quick finds the point mass's; leave one of them out")
    if arguments.force and arguments.csv is None:
        raise ConfigError("--force is for --csv, which is not given; leave it out")
    if arguments.png is not None:
        picture_format(arguments.png, "--png")
        check_may_appear(arguments.png)
    if arguments.csv is not None:
        path = Path(arguments.csv)
        if path.suffix.lower() != ".csv":
            raise TrackError(f"--csv is '{path}'; its name must end in .csv")
        if path.exists() and not arguments.force:
            raise TrackError(f"'{path}' is there already; choose another --csv, or --force to replace it")
        check_may_appear(path)


def _track_and_vehicle(words: list[str]) -> tuple[str, "VehicleModel"]:
    """The track's name and the car among these words, in any order.

    Raises:
        ConfigError: one of them is neither, or there is no such car.
    """
    overrides = [word for word in words if re.match(r"vehicle(\.\w+)?=", word)]
    track, *others = [word for word in words if word not in overrides] or [""]
    if not track:
        raise ConfigError("a track is missing; name one, as in carrl track lap-time oval")
    for other in others:
        raise ConfigError(f"'{other}' says nothing of the car; write vehicle.KEY=VALUE, such as vehicle.friction=0.9")
    from carrl.config import build_node
    from carrl.train.composition import composed

    chosen = any(override.startswith("vehicle=") for override in overrides)
    config = composed([*([] if chosen else [DEFAULT_CAR]), *overrides])
    vehicle: VehicleModel = build_node("vehicle", config["vehicle"])
    return track, vehicle


def _document(
    track: "Track", vehicle: "VehicleModel", lap: "MinimumLap", checks: "list[Check] | None"
) -> dict[str, Any]:
    document = {
        "track": track.name,
        "length_m": track.length,
        "vehicle": vars(vehicle),
        "model": lap.model,
        "lap_time_s": lap.lap_time,
        "line_length_m": lap.line.length,
        "least_speed_mps": float(lap.line.speed.min()),
        "greatest_speed_mps": float(lap.line.speed.max()),
        "at_grip_limit": lap.at_grip_limit,
        "at_walls": lap.at_walls,
        "spacing_m": lap.spacing,
        "margin_m": lap.margin,
        "stations": len(lap.line),
        "iterations": lap.iterations,
        "seconds": lap.seconds,
    }
    if checks is not None:
        document["checks"] = [dataclasses.asdict(check) for check in checks]
    return document


def _print(track: "Track", lap: "MinimumLap", checks: "list[Check]") -> None:
    from carrl.cli.text.terminal_table import print_table

    speeds = lap.line.speed
    grip = "linear tyres have none" if lap.at_grip_limit is None else f"{100 * lap.at_grip_limit:.0f} % of the time"
    rows = [
        (f"minimum lap time, {lap.model}", f"{lap.lap_time:.3f} s"),
        ("mean speed", f"{lap.line.length / lap.lap_time:.1f} m/s, {speeds.min():.1f} to {speeds.max():.1f}"),
        ("length of the line", f"{lap.line.length:,.1f} m; the centreline has {track.length:,.1f} m"),
        ("at the limit of grip", grip),
        ("at a wall", f"{100 * lap.at_walls:.0f} % of the time"),
        ("stations", f"{len(lap.line):,}, {lap.spacing:.2f} m apart"),
        ("found in", f"{lap.iterations:,} iterations, {lap.seconds:.1f} s of CPU time"),
        *((f"check: {each.name}", f"{'passed' if each.passed else 'FAILED'}: {_shown(each)}") for each in checks),
    ]
    print_table(track.name, ("", ""), rows, figures=())


def _shown(check: "Check") -> str:
    return f"{100 * check.value:.3g} % (limit {100 * check.limit:.3g} %); {check.says}"
