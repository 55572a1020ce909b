"""Lap times, sectors and the grip used on the terminal, in tables that fit 80 columns."""

from collections.abc import Mapping, Sequence
from typing import Any

from carrl.cli.text.terminal_table import print_table

Figures = Mapping[str, Any]
KINDS = ("standing", "flying")
SECTORS = ("S1", "S2", "S3")
HANDLING = {"grip_mean": "grip, mean", "grip_greatest": "grip, greatest", "steering_change": "steering change"}


def print_lap_times(tracks: Sequence[Figures]) -> None:
    """Prints the standing and the flying laps of each track, those of the rule beside, and how the car was handled."""
    drivers = [driver for track in tracks for driver in _drivers(track)]
    for kind in KINDS:
        if any(kind in figures["lap_times"] for _, figures in drivers):
            _print_laps(kind, drivers)
    if any(laps["counted"] < laps["begun"] for _, figures in drivers for laps in _kinds_of(figures)):
        print("laps that were not completed, or in which the car touched a wall, do not count")
    if any("grip_mean" in figures for _, figures in drivers):
        rows = [[name, *(_written(figures.get(key), 3) for key in HANDLING)] for name, figures in drivers]
        print_table("grip used, as a share of the limit, and steering", ["track", *HANDLING.values()], rows)
    limits = [f"{track['track']} {track['lap_times']['limit_s']:.2f} s" for track in tracks if _has_limit(track)]
    if limits:
        print(f"limit of a flying lap: {', '.join(limits)}")


def _drivers(track: Figures) -> list[tuple[str, Figures]]:
    """What the policy's row of a track is called, and its figures; then those of the rule, if they are known."""
    return [(track["track"], track), *([("  rule", track["rule"])] if "rule" in track else [])]


def _kinds_of(figures: Figures) -> list[Figures]:
    return [figures["lap_times"][kind] for kind in KINDS if kind in figures["lap_times"]]


def _print_laps(kind: str, drivers: Sequence[tuple[str, Figures]]) -> None:
    with_limit = any(_has_limit(figures) for _, figures in drivers)
    header = ["track", "laps", "mean", "best", *(["/ limit"] if with_limit else []), *SECTORS]
    rows = [_row(name, figures["lap_times"].get(kind), with_limit) for name, figures in drivers]
    print_table(f"{kind} laps: times and mean sectors, s", header, rows)


def _has_limit(figures: Figures) -> bool:
    return "limit_s" in figures["lap_times"]


def _row(name: str, laps: Figures | None, with_limit: bool) -> list[str]:
    if laps is None:
        return [name, *["-"] * (3 + with_limit + len(SECTORS))]
    limit = [_written(laps.get("share_of_limit"), 3)] if with_limit else []
    times = [laps["mean_s"], laps["best_s"]]
    sectors = laps["sectors_s"] or [None] * len(SECTORS)
    return [name, f"{laps['counted']}/{laps['begun']}", *map(_written, times), *limit, *map(_written, sectors)]


def _written(value: float | None, digits: int = 2) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
