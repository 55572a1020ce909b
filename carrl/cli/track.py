"""`carrl track`: lists, draws, checks and makes up tracks."""

import argparse
import dataclasses
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from carrl.cli.parser import Parser
from carrl.cli.track_convert import (
    add_convert_arguments,
    add_reading_flags,
    load_all_as_said,
    load_as_said,
    run_convert,
)
from carrl.cli.track_lap_time import add_lap_time_arguments, run_lap_time
from carrl.errors import TrackError, printable
from carrl.render import picture_format
from carrl.tracks.names import check_may_exist

if TYPE_CHECKING:
    from carrl.sim.drivability import Car
    from carrl.tracks.inspection import TrackReport
    from carrl.tracks.track import Track

CAR_FLAGS = (
    ("body-radius", 0.5, "of the car, a disc that must fit"),
    ("turn-radius", 7.2, "of the circle that the car drives"),
    ("step-length", 1.0, "the car drives between two decisions"),
    ("near-wall", 1.0, "where it counts as near a wall"),
)
"""Measures of the car that a road must suit, with their defaults."""


def main(argv: list[str]) -> int:
    """Runs one verb of `carrl track` and returns the exit code."""
    parser = _parser()
    arguments, others = parser.parse_known_args(argv)
    if "overrides" in arguments:  # argparse takes no more of them once a flag has come between
        arguments.overrides += [word for word in others if not word.startswith("-")]
        others = [word for word in others if word.startswith("-")]
    if others:
        parser.error(f"unrecognized arguments: {' '.join(others)}")
    return int(arguments.run(arguments))


def _parser() -> argparse.ArgumentParser:
    parser = Parser(prog="carrl track", description="list, draw, check and make up tracks")
    verbs = parser.add_subparsers(metavar="VERB", required=True)

    def add_verb(name: str, run: Any, what: str, json_flag: bool = True) -> argparse.ArgumentParser:
        verb = verbs.add_parser(name, help=what, description=what)
        verb.set_defaults(run=run)
        if json_flag:
            verb.add_argument("--json", action="store_true", help="print one JSON document and nothing else")
        return verb

    listing = add_verb("list", _list, "the tracks that come with CarRL, or those of folders")
    listing.add_argument("folders", nargs="*", metavar="FOLDER", help="whose circuits to list, and those below it")
    show = add_verb("show", _show, "draw a track", json_flag=False)
    show.add_argument(
        "track", metavar="NAME|FILE", help="a built-in track, a file, or the name of a file in CARRL_TRACKS"
    )
    add_reading_flags(show)
    show.add_argument(
        "--out",
        metavar="FILE",
        help="a .png, .pdf or .svg; default: the track's name.png; an older picture is replaced",
    )
    check = add_verb("check", _check, "measure tracks and find their faults; exit code 1 where there are any")
    check.add_argument(
        "tracks",
        nargs="+",
        metavar="NAME|FILE|FOLDER",
        help="a built-in track, a file or the name of one in CARRL_TRACKS, or a folder for all in it",
    )
    add_reading_flags(check)
    for flag, of_default, what in CAR_FLAGS:
        check.add_argument(f"--{flag}", type=float, metavar="M", help=f"{what}, m (default {of_default:g})")
    convert = add_verb("convert", run_convert, "write a track in another format", json_flag=False)
    add_convert_arguments(convert)
    lap_time = add_verb("lap-time", run_lap_time, "find the minimum lap time of a car, and the line for it")
    add_lap_time_arguments(lap_time)
    random = add_verb("random", _random, "draw random circuits and write each as a CSV file")
    random.add_argument("--seed", type=int, default=0, metavar="N", help="of the first circuit (default 0)")
    random.add_argument("--count", type=int, default=1, metavar="N", help="how many circuits, of seeds from there on")
    for measure in ("corner-radius", "width", "length"):
        random.add_argument(
            f"--{measure}", type=float, nargs="+", metavar="M", help="m: one number, or two that are a range"
        )
    random.add_argument(
        "--corner-spacing",
        type=float,
        nargs="+",
        metavar="R",
        help="in least radii: one number, or two that are a range",
    )
    random.add_argument("--widening", type=float, metavar="SHARE", help="how much wider the road is in places")
    random.add_argument("--hairpins", type=float, metavar="SHARE", help="of the U-turns that are one acute corner")
    random.add_argument(
        "--out", metavar="FILE.csv", help="default: random-SEED.csv; with --count above 1 each name gets its seed"
    )
    random.add_argument("--force", action="store_true", help="replace files that are there already")
    return parser


def _list(arguments: argparse.Namespace) -> int:
    from carrl.tracks.circuits import FolderError, load_folder
    from carrl.tracks.inspection import inspect_track
    from carrl.tracks.library import library_folders
    from carrl.tracks.track import Track, builtin_names

    named = list(map(Path, arguments.folders)) or library_folders()
    tracks = [] if arguments.folders else [Track.load(name) for name in builtin_names()]
    refused: list[tuple[str, str]] = []
    for folder in named:
        try:
            found, bad = load_folder(folder)
        except FolderError as error:
            found, bad = [], error.refused or {folder: str(error)}
        tracks += found
        refused += [(str(path), reason) for path, reason in bad.items()]
    reports = [inspect_track(track) for track in tracks]
    if arguments.json:
        _print_json([_as_json(report) for report in reports])
    else:
        header = ("track", "length", "width", "least radius", "gates")
        from carrl.cli.text.terminal_table import print_table

        title = ", ".join(map(str, named if arguments.folders else ["built-in tracks", *named]))
        print_table(title, header, [_row(report) for report in reports])
    if arguments.json:
        for _, reason in refused:
            print(f"carrl: {printable(reason)}", file=sys.stderr)
    elif refused:
        from carrl.cli.text.terminal_table import print_table

        print_table(f"{len(refused)} files that are no tracks", ("file", "why"), refused, figures=(), to_stderr=True)
    return 2 if refused else 0


def _show(arguments: argparse.Namespace) -> int:
    path = Path(arguments.out or f"{Path(arguments.track).stem}.png")
    picture_format(path, "--out")
    check_may_exist(arguments.track)
    from carrl.render.corridor import draw_corridor  # From here on it takes seconds.
    from carrl.render.track_map import draw_track_map
    from carrl.tracks.rings import CorridorError

    try:
        track = load_as_said(arguments)
    except CorridorError as error:
        path = path if arguments.out else path.with_name(f"{path.stem}-found.png")
        draw_corridor(path, error)
        print(printable(str(path)))
        raise
    draw_track_map(path, track, f"{track.name}: {track.length:,.0f} m, {track.gate_count} gates")
    print(printable(str(path)))
    return 0


def _check(arguments: argparse.Namespace) -> int:
    """Checks every track even when one cannot be read, and returns the gravest exit code."""
    if len(arguments.tracks) == 1 and not arguments.json:
        check_may_exist(arguments.tracks[0])
    from carrl.sim.drivability import unsuitable  # From here on it takes seconds.
    from carrl.tracks.inspection import inspect_track

    car, is_given = _car(arguments)
    exit_code = 0
    documents: list[dict[str, Any]] = []
    for name in _named(arguments.tracks):
        try:
            tracks = load_all_as_said(arguments, name)
            reports = [inspect_track(track, car.body_radius) for track in tracks]
        except TrackError as error:
            exit_code = 2
            print(f"carrl: {printable(str(error))}", file=sys.stderr)
            documents.append({"path": name, "error": str(error)})
            continue
        for track, report in zip(tracks, reports, strict=True):
            warnings = unsuitable(track, car) if report.width_min > 2 * car.body_radius else []
            if is_given:
                report, warnings = dataclasses.replace(report, faults=(*report.faults, *warnings)), []
            exit_code = max(exit_code, 1 if report.faults else 0)
            documents.append({"path": name, **_as_json(report), "notes": list(track.notes), "warnings": warnings})
            if not arguments.json:
                _print_report(report, car, warnings, track.notes)
    if arguments.json:
        _print_json(documents)
    return exit_code


def _car(arguments: argparse.Namespace) -> tuple["Car", bool]:
    """The car that is to drive, and whether more of it was said than its size; the default car is no fault of a road's.

    Raises:
        TrackError: a flag is no length.
    """
    from carrl.sim.drivability import Car

    given = {}
    for flag, _, _ in CAR_FLAGS:
        name = flag.replace("-", "_")
        value = getattr(arguments, name)
        if value is not None and not 0 < value < float("inf"):
            raise TrackError(f"--{flag} is {value}; it must be a positive number of metres")
        if value is not None:
            given[name] = value
    return Car(**given), bool(given.keys() - {"body_radius"})


def _named(names: Sequence[str]) -> list[str]:
    """The names with each folder replaced by the circuits in it."""
    from carrl.tracks.circuits import circuit_files

    return [path for name in names for path in (map(str, circuit_files(Path(name))) if Path(name).is_dir() else [name])]


def _random(arguments: argparse.Namespace) -> int:
    from carrl.tracks.csv_file import write_csv
    from carrl.tracks.inspection import inspect_track
    from carrl.tracks.track import Track

    if arguments.count < 1:
        raise TrackError(f"--count is {arguments.count}; it must be at least 1")
    seeds = range(arguments.seed, arguments.seed + arguments.count)
    paths = [_path_of(seed, arguments) for seed in seeds]
    for path in paths:
        if path.exists() and not arguments.force:
            raise TrackError(f"'{path}' is there already; choose another --out, or --force to replace it")
    reports = []
    for seed, path in zip(seeds, paths, strict=True):
        track = Track.random(seed, **_shape(arguments))
        write_csv(path, _centreline_of(track))
        reports.append({"path": str(path), "seed": seed, **_as_json(inspect_track(track))})
        if not arguments.json:
            print(path)
    if arguments.json:
        _print_json(reports)
    return 0


def _path_of(seed: int, arguments: argparse.Namespace) -> Path:
    path = Path(arguments.out or f"random-{seed}.csv")
    if path.suffix.lower() != ".csv":
        raise TrackError(f"--out is '{path}'; the track is a CSV file, so its name must end in .csv")
    return path.with_name(f"{path.stem}-{seed}.csv") if arguments.out and arguments.count > 1 else path


def _shape(arguments: argparse.Namespace) -> dict[str, Any]:
    """What was said of the circuits' shape: of the measures, one number as itself, more as a range."""
    names = ("corner_radius", "width", "length", "corner_spacing", "widening", "hairpins")
    given = {name: getattr(arguments, name) for name in names if getattr(arguments, name) is not None}
    return {name: value[0] if isinstance(value, list) and len(value) == 1 else value for name, value in given.items()}


def _centreline_of(track: "Track") -> Any:
    """The centreline and widths of a track whose walls stand square to it, as those of `Track.random` do."""
    from carrl.tracks.centreline import Centreline

    middle, left, right = (line.double() for line in (track.centreline, track.left_wall, track.right_wall))
    widths = ((side - middle).norm(dim=1).numpy() for side in (right, left))
    return Centreline(middle.numpy(), *widths)


def _as_json(report: "TrackReport") -> dict[str, Any]:
    return dataclasses.asdict(report)


def _print_json(document: Any) -> None:
    print(json.dumps(document, indent=2))


def _row(report: "TrackReport") -> tuple[str, ...]:
    from carrl.sim.drivability import metres

    radii = [radius for radius in (report.least_radius_left, report.least_radius_right) if radius is not None]
    radius = metres(min(radii)) if radii else "none"
    return (report.name, f"{report.length:,.1f} m", _width(report), radius, str(report.gates))


def _width(report: "TrackReport") -> str:
    from carrl.sim.drivability import metres

    low, high = metres(report.width_min), metres(report.width_max)
    return low if low == high else f"{low.removesuffix(' m')} to {high}"


def _print_report(report: "TrackReport", car: "Car", warnings: Sequence[str], notes: Sequence[str]) -> None:
    from carrl.sim.drivability import metres

    left, right = (
        "no turns" if radius is None else metres(radius)
        for radius in (report.least_radius_left, report.least_radius_right)
    )
    bridges = [
        f"{b.over[0]:,.0f} to {b.over[1]:,.0f} m over {b.under[0]:,.0f} to {b.under[1]:,.0f} m" for b in report.bridges
    ]
    rows = [
        ("length", f"{report.length:,.1f} m"),
        ("width", _width(report)),
        ("least radius, left", left),
        ("least radius, right", right),
        ("points of the centreline", f"{report.points:,}"),
        ("repeated points left out", f"{report.repeats:,}"),
        ("walls", f"{report.walls:,}"),
        ("gates", f"{report.gates:,}"),
        ("bridges", "; ".join(bridges) or "none"),
        ("folds cut", f"{report.folds}"),
        ("the car's turn radius", metres(car.turn_radius)),
        ("its step", metres(car.step_length)),
        ("its body radius", metres(car.body_radius)),
        ("near a wall for it", metres(car.near_wall)),
        *(("read", note) for note in notes),
        ("faults", f"{len(report.faults)}" if report.faults else "none"),
    ]
    from carrl.cli.text.terminal_table import print_table

    print_table(report.name, ("", ""), rows, figures=())
    for fault in report.faults:
        print(f"fault: {fault}")
    for warning in warnings:
        print(f"warning: for the default car, {warning}")
