"""`carrl race`: trained policies race each other, or one of them races opponents."""

import argparse
import json
import os
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from carrl.cli.parser import Parser, add_trust
from carrl.errors import ConfigError, printable
from carrl.evaluation.asked import MOST_LAPS, MOST_RACES, check_is_free
from carrl.task.checks import number, whole_number
from carrl.tracks.names import check_may_exist
from carrl.train.files import checkpoint_path, load_config, seed_folders

if TYPE_CHECKING:
    from carrl.evaluation.drive_log import DriveLog
    from carrl.evaluation.race_grid import Entrant
    from carrl.evaluation.standings import Race
    from carrl.tracks.track import Track

OPPONENTS = ("line", "rule")
CARS, MOST_CARS = 6, 64
LAPS, RACES = 3, 10

Figures = Mapping[str, Any]


def main(argv: list[str]) -> int:
    """Prints the races and a league table, or one JSON document."""
    arguments = _parser().parse_intermixed_args(argv)
    folders = _check(arguments)
    print(printable(_announced(arguments, len(folders))), file=sys.stderr, flush=True)
    import torch  # From here on it takes seconds.

    torch.set_num_threads(1)
    document = _race(arguments, folders)
    if arguments.json:
        print(json.dumps(document, indent=2))
    else:
        print_races(document)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="carrl race",
        description="Lets the best networks of runs race each other, each with the sensors of its run, or each run "
        "race opponents by itself. A car that touches a wall is out, and so is one that touches another car, if that "
        "ended its run's episodes.",
    )
    parser.add_argument(
        "run",
        nargs="+",
        metavar="RUN",
        help="the folder of a run, which drives one car; one of several seeds stands for all of them; a run may be "
        "named several times",
    )
    parser.add_argument(
        "--track",
        action="append",
        required=True,
        metavar="NAME|FILE|FOLDER",
        help="a folder stands for all circuits in it; may be repeated",
    )
    parser.add_argument("--laps", type=int, default=LAPS, metavar="N", help=f"of each race; default: {LAPS}")
    parser.add_argument(
        "--races",
        type=int,
        default=RACES,
        metavar="N",
        help=f"on each track, whose start lines are spread evenly along it; default: {RACES}",
    )
    parser.add_argument("--opponents", choices=OPPONENTS, help="each run races these by itself, and starts last")
    parser.add_argument("--pace", type=float, metavar="SHARE", help="of the opponents; default: theirs")
    parser.add_argument(
        "--cars", type=int, metavar="K", help=f"in a race against opponents, the run's included; default: {CARS}"
    )
    parser.add_argument(
        "--log",
        type=Path,
        metavar="FILE.mcap",
        help="keep what the first RUN's first car drives in a new file, for carrl log; each race is an episode",
    )
    add_trust(parser)
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    return parser


def _check(arguments: argparse.Namespace) -> list[Path]:
    """The folder of each run that drives.

    Raises:
        CarrlError: a flag cannot be done as asked, or a folder is no run's.
    """
    whole_number("laps", arguments.laps, 1, MOST_LAPS)
    whole_number("races", arguments.races, 1, MOST_RACES)
    for flag, value in (("--pace", arguments.pace), ("--cars", arguments.cars)):
        if value is not None and arguments.opponents is None:
            raise ConfigError(f"{flag} has no effect without --opponents; add that, or leave it out")
    if arguments.pace is not None:
        number("pace", arguments.pace, 0.01, 1, "a share between 0.01 and 1")
    if arguments.cars is not None:
        whole_number("cars", arguments.cars, 2, MOST_CARS)
    if arguments.log is not None:
        check_is_free(arguments.log)
    for track in arguments.track:
        check_may_exist(track)
    folders = [folder for run in arguments.run for folder in seed_folders(Path(run))]
    for folder in dict.fromkeys(folders):
        load_config(folder, arguments.trust)
        if not os.path.isfile(path := checkpoint_path(folder, "best")):
            raise ConfigError(f"'{path}' is not there yet; a run in progress has it from its first evaluation on")
    if arguments.opponents is None:
        if len(folders) == 1:
            raise ConfigError(f"'{folders[0]}' has nobody to race; name several runs, or add --opponents line")
        whole_number("the number of cars", len(folders), 2, MOST_CARS)
    elif arguments.log is not None and len(folders) > 1:
        raise ConfigError(f"--log keeps the races of one run, and here are {len(folders)}; name the folder of one")
    return folders


def _announced(arguments: argparse.Namespace, entrants: int) -> str:
    """What is about to take a while."""
    races = f"{arguments.races} {'race' if arguments.races == 1 else 'races'}"
    laps = f"{arguments.laps} {'lap' if arguments.laps == 1 else 'laps'}"
    if arguments.opponents is None:
        who = f"{entrants} cars"
    else:
        runs = "one run" if entrants == 1 else f"{entrants} runs, one after the other,"
        who = f"{runs} against {(arguments.cars or CARS) - 1} opponents by {arguments.opponents}"
    return f"racing {who} on {', '.join(arguments.track)}: {races} of {laps} on each track"


def _race(arguments: argparse.Namespace, folders: Sequence[Path]) -> dict[str, Any]:
    from carrl.evaluation.standings import ELO_START, ELO_STEP
    from carrl.train.run import load_tracks

    tracks, refused = load_tracks(arguments.track)
    for path, reason in refused.items():
        print(printable(f"warning: left out '{path}': {reason}"), file=sys.stderr)
    if not tracks:
        raise ConfigError("there is no track to race on; name one that can be read")
    entrants = _entrants(folders, arguments.trust)
    document: dict[str, Any] = {
        "tracks": [track.name for track in tracks],
        "laps": arguments.laps,
        "elo": {"start": ELO_START, "k": ELO_STEP},
        **({"refused": refused} if refused else {}),
    }
    if arguments.opponents is None:
        races = _on_all(entrants, tracks, arguments, folders[0])
        runs = {entrant.name: str(folder) for entrant, folder in zip(entrants, folders, strict=True)}
        return document | {"runs": runs, **_figures(races)}
    pace = {} if arguments.pace is None else {"pace": arguments.pace}
    document |= {"opponents": arguments.opponents, **pace, "cars": arguments.cars or CARS, "runs": []}
    for entrant, folder in zip(_among(entrants, arguments), folders, strict=True):
        figures = _figures(_on_all([entrant], tracks, arguments, folder))
        document["runs"].append({"run": str(folder), "car": entrant.name, **figures})
    return document


def _on_all(
    entrants: "Sequence[Entrant]", tracks: "Sequence[Track]", arguments: argparse.Namespace, first: Path
) -> "list[Race]":
    """The races on each of the tracks, one after the other; the folder is that of the first entrant."""
    from carrl.evaluation.race import drive_races

    asked = arguments.laps, arguments.races
    with _recorder(arguments, tracks, len(entrants), first) as recorder:
        return [race for track in tracks for race in drive_races(entrants, track, *asked, recorder)]


def _recorder(
    arguments: argparse.Namespace, tracks: "Sequence[Track]", entrants: int, first: Path
) -> "AbstractContextManager[DriveLog | None]":
    """What keeps the races, if anything does."""
    if arguments.log is None:
        return nullcontext()
    from carrl.evaluation.drive_log import DriveLog
    from carrl.train.experiment import as_yaml
    from carrl.train.plan import checked_seed

    config = load_config(first, arguments.trust)
    cars = (arguments.cars or CARS) if arguments.opponents else entrants
    entries = {"policy": "greedy", "run_folder": str(first.resolve()), "checkpoint": "best"}
    drives, seed = len(tracks) * arguments.races, checked_seed(config["seed"])
    return DriveLog(arguments.log, as_yaml(config), tracks, drives, seed, entries, cars - 1)


def _figures(races: "Sequence[Race]") -> dict[str, Any]:
    from carrl.evaluation.standings import league

    return {"races": [race.measures() for race in races], "league": league(races)}


def _entrants(folders: Sequence[Path], trust: Sequence[str]) -> "list[Entrant]":
    """Who drives; a run that is named several times is loaded once."""
    from carrl.evaluation.race_grid import Entrant
    from carrl.train.build import load_driver

    loaded = {folder: load_driver(folder, load_config(folder, trust)) for folder in dict.fromkeys(folders)}
    return [Entrant(name, *loaded[folder]) for name, folder in zip(_names(folders), folders, strict=True)]


def _names(folders: Sequence[Path]) -> list[str]:
    """The ends of the folders' paths that tell them apart, numbered where a run drives several cars."""
    paths = [folder.absolute() for folder in folders]
    distinct, length = set(paths), 1
    while len({path.parts[-length:] for path in distinct}) < len(distinct):
        length += 1
    counts, names = Counter[str](), []
    for path in paths:
        name = "/".join(path.parts[-length:])
        counts[name] += 1
        names.append(name if counts[name] == 1 else f"{name} ({counts[name]})")
    return names


def _among(entrants: "Sequence[Entrant]", arguments: argparse.Namespace) -> "list[Entrant]":
    """The same, each with the opponents that are asked for in its world."""
    from dataclasses import replace

    from carrl.config import build_node
    from carrl.train.composition import composed

    pace = [] if arguments.pace is None else [f"opponents.pace={arguments.pace}"]
    opponents = build_node("opponents", composed([f"opponents={arguments.opponents}", *pace])["opponents"])
    own = {"opponents": opponents, "cars_per_world": arguments.cars or CARS}
    return [entrant._replace(world=replace(entrant.world, **own)) for entrant in entrants]


def print_races(document: Figures) -> None:
    """Prints a row for each race and car, but for those of opponents, and a table over all races."""
    from carrl.cli.text.terminal_table import print_table

    is_among = "opponents" in document
    groups = document["runs"] if is_among else [document]
    rows, table = [], []
    for group in groups:
        shown = {group["car"]} if is_among else {row["car"] for row in group["league"]}
        for number_of, race in enumerate(group["races"], start=1):
            rows += [_race_row(number_of, race, row) for row in race["cars"] if row["car"] in shown]
        table += [_league_row(row) for row in group["league"] if row["car"] in shown]
    laps, tracks = document["laps"], ", ".join(document["tracks"])
    against = f" against {document['cars'] - 1} of {document['opponents']}" if is_among else ""
    header = ("race", "car", "place", "time, s", "best lap", "passed", "contacts")
    print_table(f"{laps} {'lap' if laps == 1 else 'laps'} of {tracks}{against}", header, rows, figures=header[2:])
    header = ("car", "wins", "place", "won", "best lap", "own contacts / km", "Elo")
    print_table("all races", header, table, figures=header[1:])
    print("place: at the end, from where at the start; won: places, on average;")
    print("contacts: at own fault + others; per km with its 95 % interval")


def _race_row(number_of: int, race: Figures, row: Figures) -> list[str]:
    took = {"wall": "out: wall", "car": "out: car", "time": "time up"}
    return [
        f"{number_of} {race['track']}",
        row["car"],
        f"{row['place']} from {row['start']}",
        took.get(row["ended"], "-") if row["time"] is None else f"{row['time']:.2f}",
        "-" if row["best_lap"] is None else f"{row['best_lap']:.2f}",
        str(row["overtakes"]),
        f"{row['contacts_own']} + {row['contacts_others']}",
    ]


def _league_row(row: Figures) -> list[str]:
    low, high = row["intervals"]["contacts_own_per_km"]
    return [
        row["car"],
        f"{row['wins']}/{row['races']}",
        f"{row['mean_place']:.1f}",
        f"{row['places_won']:+.1f}",
        "-" if row["best_lap"] is None else f"{row['best_lap']:.2f}",
        f"{row['contacts_own_per_km']:.2f} ({low:.2f}-{high:.2f})",
        f"{row['elo']:.0f}",
    ]
