"""Laps from files, to be compared: those that `carrl evaluate --speed-trace` wrote, and lines with their speeds."""

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from carrl.errors import ConfigError
from carrl.evaluation.speed_trace import HEADER, read_speed_table
from carrl.files import read_whole
from carrl.racing.laps import Lap
from carrl.racing.reference_line import COLUMNS, MAX_FILE_BYTES, ReferenceLine
from carrl.render.colours import LAPS
from carrl.tracks.track import Track

MOST_LAPS = len(LAPS)
"""Of which each can have a colour of its own."""


def read_laps(paths: Sequence[str | Path], track: Track) -> list[Lap]:
    """The laps of some files on a track, in their order.

    Of a speed trace it is the lap of each driver that begins at the start line.

    Args:
        paths: of CSV files, each a speed trace or a reference line, as their headers tell.
        track: where they were driven.

    Raises:
        CarrlError: one is neither, has no such lap, or there are more than `MOST_LAPS`.
    """
    names = _names(paths)
    laps = [lap for path, name in zip(paths, names, strict=True) for lap in _laps_of(Path(path), name, track)]
    if len(laps) > MOST_LAPS:
        raise ConfigError(
            f"there are {len(laps)} laps, of {', '.join(lap.name for lap in laps[: MOST_LAPS + 1])} and so on; at most "
            f"{MOST_LAPS} can be told apart, so name fewer files, or such as have one driver each"
        )
    return laps


def _names(paths: Sequence[str | Path]) -> list[str]:
    """The files' names without their endings, or all that was typed of those that share one.

    Raises:
        ConfigError: a file is named twice.
    """
    typed = [str(path) for path in paths]
    for path, count in Counter(typed).items():
        if count > 1:
            raise ConfigError(f"'{path}' is named twice; leave one of them out")
    stems = Counter(Path(path).stem for path in paths)
    return [Path(path).stem if stems[Path(path).stem] == 1 else str(path) for path in paths]


def _laps_of(path: Path, name: str, track: Track) -> Iterator[Lap]:
    said = f"lap '{path.name}'"
    text = read_whole(path, MAX_FILE_BYTES, said, ConfigError).decode(errors="replace")
    header = [word.strip() for word in text.partition("\n")[0].removeprefix("#").split(",")]
    if header == list(COLUMNS):
        line = ReferenceLine.read(path).closed()
        poses = np.column_stack([line.places, line.heading])
        yield Lap.of(name, track, line.time, poses, line.speed)
        return
    if header != list(HEADER):
        raise ConfigError(
            f"{said}: its first line is none that is known; make it by carrl evaluate --speed-trace, or by carrl track "
            "lap-time --csv"
        )
    driven = read_speed_table(text, said)
    here = {
        driver: table
        for (driver, where, start), table in driven.items()
        if Path(where).stem == Path(track.name).stem and start == 0
    }
    if not here:
        others = sorted({where for _, where, _ in driven if Path(where).stem != Path(track.name).stem})
        there = f"; its laps are of {', '.join(others)}" if others else ""
        raise ConfigError(f"{said}: it has no lap of track '{track.name}' from its start line on{there}")
    for driver, table in here.items():
        if len(table) < 3:
            raise ConfigError(f"{said}: the lap of {driver} has {len(table)} moments; it must have at least 3")
        yield Lap.of(name if len(here) == 1 else f"{name}: {driver}", track, table[:, 0], table[:, 1:4], table[:, 4])
