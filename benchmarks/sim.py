"""`scripts/bench sim`: car-steps a second of the simulator and of what is built on it, beside VMAS."""

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from benchmarks import figures, sim_profile, sim_tables, sim_traffic
from benchmarks.child import CIRCUITS, BenchError
from benchmarks.machine import describe_machine, machine_line
from benchmarks.options import Parser, names_of, positive, tell, writable
from benchmarks.sim_cells import LONGEST_CALL_S, PAPER, Course, measure
from benchmarks.sim_drives import CONTESTANTS, VMAS, LeftOutError
from benchmarks.sim_first_use import time_first_use
from benchmarks.sim_limit import measure_limit
from benchmarks.sim_tables import Reference, Row

SPA = CIRCUITS / "Spa.csv"
CARS = tuple(4**power for power in range(8))
WORLDS = 1, 4, 8
"""Cars a world."""
NOTES = (
    "One thread each; car-steps of all cars together, with 7 rays each and cars put back after a collision.",
    "Actions are random and drawn beforehand, but for the Collector, whose policy draws them as it goes.",
    "VMAS: our own scenario, without gates, its collisions read from its lidar, its cars put back all at once.",
    f"Numbers of cars go up to where a step of all of them would take more than {LONGEST_CALL_S:g} s.",
    "Columns of ratios: of the medians, each at its best number of cars, and in brackets min..max by round.",
)
Table = Callable[[Sequence[str], Sequence[Sequence[str]]], str]


def main(argv: list[str] | None = None) -> int:
    """Measures and prints; returns 0, or 1 where something failed."""
    arguments = _parse(argv)
    course = Course(arguments.track, arguments.cars, arguments.seconds)
    result: dict[str, Any] = {"machine": describe_machine(), "seconds": course.seconds, "tracks": course.tracks}
    table = figures.markdown_table if arguments.markdown else figures.plain_table
    print(machine_line(result["machine"]) + "\n")
    try:
        cars = course.cars[-1]
        if not arguments.no_race:
            rows = _race(course, arguments, result, table)
            cars = next((row.best_cars for row in rows if row.contestant == "env"), cars)
            result["first_use_s"] = _first_use()
        if arguments.cars_per_world:
            result["cars_per_world"] = _worlds(course, arguments, table)
        if arguments.profile:
            result["profile"] = _profile(course, cars, table)
        code = 0
    except BenchError as error:
        print(f"scripts/bench sim: {error}", file=sys.stderr)
        code = 1
    except KeyboardInterrupt:
        code = 130
    if arguments.json:  # also what was measured before something failed
        arguments.json.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    return code


def _parse(argv: list[str] | None) -> argparse.Namespace:
    parser = Parser(prog="scripts/bench sim", description=__doc__)
    parser.add_argument("--rounds", type=positive(int), default=3, metavar="N", help="of all contestants in turn")
    parser.add_argument(
        "--seconds", type=positive(float), default=0.5, metavar="S", help="each drives with each number of cars"
    )
    parser.add_argument(
        "--only",
        type=names_of(list(CONTESTANTS)),
        default=list(CONTESTANTS),
        metavar="NAME,...",
        help=f"contestants, of: {', '.join(CONTESTANTS)}",
    )
    parser.add_argument(
        "--track",
        action="append",
        type=_track,
        metavar="NAME|FILE",
        help="may be repeated; the others are compared with the first; default: paper, and Spa where its file is found",
    )
    parser.add_argument("--cars", type=_cars, default=list(CARS), metavar="N,...", help="how many side by side")
    parser.add_argument(
        "--limit-program", type=_program, metavar="PATH", help="also compare with a hand-written program"
    )
    parser.add_argument("--profile", action="store_true", help="also show where TrackEnv's time goes")
    parser.add_argument(
        "--cars-per-world",
        type=_cars,
        nargs="?",
        const=list(WORLDS),
        metavar="N,...",
        help=f"also what several cars in a world cost; default: {','.join(map(str, WORLDS))}",
    )
    parser.add_argument(
        "--no-race", action="store_true", help="only what --profile and --cars-per-world ask for, with the most cars"
    )
    parser.add_argument("--markdown", action="store_true", help="print tables for a page")
    parser.add_argument("--json", type=writable, metavar="FILE", help="keep all figures, of every round")
    arguments = parser.parse_args(argv)
    if arguments.no_race and not (arguments.profile or arguments.cars_per_world):
        parser.error("--no-race leaves nothing to do; add --profile or --cars-per-world")
    arguments.left_out = {}
    if not arguments.track:
        arguments.track = [PAPER, str(SPA)] if SPA.is_file() else [PAPER]
        if not SPA.is_file():
            arguments.left_out["Spa"] = f"there is no {SPA}; name its file with --track"
    return arguments


def _track(text: str) -> str:
    from carrl.errors import CarrlError
    from carrl.tracks.track import Track

    name = text if not Path(text).is_file() else str(Path(text).absolute())
    try:
        Track.load(name)
    except CarrlError as error:
        raise argparse.ArgumentTypeError(str(error)) from error
    return name


def _cars(text: str) -> list[int]:
    return sorted({int(positive(int)(word)) for word in text.split(",")})


_cars.__name__ = "list of whole numbers"


def _program(text: str) -> Path:
    if not Path(text).is_file():
        raise argparse.ArgumentTypeError(f"there is no program '{text}'; compile it first")
    return Path(text)


def _race(course: Course, arguments: argparse.Namespace, result: dict[str, Any], table: Table) -> list[Row]:
    """Measures all contestants in turn, round after round, and prints the tables."""
    rows: dict[tuple[str, str], Row] = {}
    left_out: dict[str, str] = arguments.left_out
    limit: list[float] = []
    for number in range(1, arguments.rounds + 1):
        for name in arguments.only:
            tell(f"round {number} of {arguments.rounds}: {CONTESTANTS[name].title}")
            try:
                cells = measure(name, course)
            except LeftOutError as reason:
                left_out[CONTESTANTS[name].title] = str(reason)
                continue
            for cell in cells:
                row = rows.setdefault((name, cell.track), _row(name, cell.track))
                row.speeds.setdefault(cell.cars, []).append(cell.steps_per_s)
        if arguments.limit_program:
            tell(f"round {number} of {arguments.rounds}: {arguments.limit_program}")
            limit.append(measure_limit(arguments.limit_program))
    measured = [_whole(row, arguments.rounds) for row in rows.values()]
    result["speed"] = {row.title: row.speeds for row in measured}
    result["limit"], result["left_out"] = limit, left_out
    references = _references(measured, course, limit)
    for header, lines in (sim_tables.sizes_table(measured), sim_tables.best_table(measured, references)):
        print(table(header, lines) + "\n")
    print(f"Medians of {arguments.rounds} interleaved rounds, {course.seconds:g} s for each cell after a warm-up.")
    print("\n".join(NOTES))
    if limit:
        millions = figures.spread([speed / 1e6 for speed in limit], digits=2)
        print(f"'times C' is against {arguments.limit_program.name} with 256 walls: {millions} million car-steps/s.")
    for title, reason in left_out.items():
        print(f"Left out: {title}: {reason}.")
    print()
    return measured


def _row(name: str, track: str) -> Row:
    return Row(name, track, f"{CONTESTANTS[name].title}, {Path(track).stem}")


def _whole(row: Row, rounds: int) -> Row:
    """Without the numbers of cars that were too slow to be measured in every round."""
    whole = {cars: speeds for cars, speeds in row.speeds.items() if len(speeds) == rounds}
    return Row(row.contestant, row.track, row.title, whole)


def _references(rows: Sequence[Row], course: Course, limit: Sequence[float]) -> list[Reference]:
    best = {row.contestant: row.best for row in rows if row.contestant in VMAS}
    references = [
        sim_tables.against_all(f"times {CONTESTANTS[name].title}", rows, best[name]) for name in VMAS if name in best
    ]
    if limit:
        references.append(sim_tables.against_all("times C", rows, limit))
    first = course.tracks[0]
    if len(course.tracks) > 1:
        references.append(sim_tables.against_first_track(f"times {Path(first).stem}", rows, first))
    return references


def _first_use() -> dict[str, float]:
    tell("first use of the simulator")
    seconds = time_first_use()
    print("Making a simulator and its first step: ", end="")
    print(", ".join(f"{took:.1f} s with {state} caches of compiled code" for state, took in seconds.items()) + ".\n")
    return seconds


def _worlds(course: Course, arguments: argparse.Namespace, table: Table) -> dict[str, sim_traffic.Cost]:
    """Measures several cars in a world on every track, and prints a table of each."""
    found = {}
    for track in course.tracks:
        tell(f"cars a world: {Path(track).stem}")
        found[track] = sim_traffic.measure_worlds(track, arguments.cars_per_world, course.seconds, arguments.rounds)
        print(
            f"The simulator with several cars in a world, about {sim_traffic.CARS:,} in all, on {Path(track).stem}:\n"
        )
        print(table(*sim_traffic.table(found[track])) + "\n")
    return found


def _profile(course: Course, cars: int, table: Table) -> dict[str, Any]:
    found = {}
    for track in course.tracks:
        tell(f"profile: {Path(track).stem}")
        rows, resets = sim_profile.profile_env(track, cars, 4 * course.seconds)
        found[track] = {"cars": cars, "rows": rows, "resets": resets}
        print(f"TrackEnv with {cars:,} cars on {Path(track).stem}. cProfile slows Python down, and native code not:\n")
        print(table(sim_profile.HEADER, rows))
        print(f"\nNative functions count for who calls them. Resets, with all that they call: {resets:.1%}.\n")
    return found


if __name__ == "__main__":
    sys.exit(main())
