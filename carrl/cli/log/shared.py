"""What several verbs of `carrl log` share: flags, the choice of an episode, and text and JSON for any log."""

import argparse
import dataclasses
import json
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from carrl.errors import CarrlError, LogError, printable
from carrl.log.codec import Columns, Selection
from carrl.log.messages import Episode
from carrl.log.reader import Log
from carrl.log.scene import Scene
from carrl.log.schema import Column, Schema
from carrl.log.trace import EpisodeTrace, read_trace

Verbs: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"
Run: TypeAlias = Callable[[argparse.Namespace], int]

_MOST_DIGITS = 18
"""Of a whole number that fits 64 bits."""


def add_verb(verbs: Verbs, name: str, run: Run, help_text: str, description: str) -> argparse.ArgumentParser:
    """Adds a verb that reads one log.

    Args:
        verbs: those of `carrl log`.
        name: the verb.
        run: what it does; returns the exit code.
        help_text: a few words for the list of verbs.
        description: what it does, in a sentence or two.
    """
    verb = verbs.add_parser(name, help=help_text, description=description)
    verb.set_defaults(run=run)
    verb.add_argument("file", metavar="FILE", help="a log, such as train.mcap in a run's folder")
    return verb


def add_json(verb: argparse.ArgumentParser, help_text: str = "print one JSON document and nothing else") -> None:
    """Adds `--json`."""
    verb.add_argument("--json", action="store_true", help=help_text)


def add_episode(verb: argparse.ArgumentParser) -> None:
    """Adds `--episode`, for a verb that shows one."""
    verb.add_argument(
        "--episode", type=whole_number, metavar="E", help="which one (default: that with the highest return)"
    )


def add_selection(verb: argparse.ArgumentParser) -> None:
    """Adds the flags that `selection_of` reads."""
    verb.add_argument(
        "--episode", type=whole_number, action="append", metavar="E", help="only this episode; may be repeated"
    )
    verb.add_argument("--env", type=whole_number, action="append", metavar="N", help="only this car; may be repeated")
    verb.add_argument("--begin", type=seconds, metavar="S", help="only from this simulated time on, s")
    verb.add_argument("--end", type=seconds, metavar="S", help="only before this simulated time, s")


def selection_of(arguments: argparse.Namespace) -> Selection:
    """Which transitions the flags ask for.

    Raises:
        LogError: the time ends before it begins.
    """
    begin, end = arguments.begin, arguments.end
    if begin is not None and end is not None and end <= begin:
        raise LogError(f"--end is {end:g} s; it must be later than --begin, {begin:g} s")
    return Selection(arguments.episode, arguments.env, begin, end)


def check_output(out: Path, source: Path) -> None:
    """Refuses to write a file over the log that it is made of, whatever both are called.

    Raises:
        CarrlError: they are one file.
    """
    with suppress(OSError, ValueError):  # whoever opens them says what is wrong
        if out.samefile(source):
            raise CarrlError(f"'{out}' is the log itself; choose another name")


def whole_number(text: str) -> int:
    """The number that is written there, from 0 on."""
    if not (text.isascii() and text.isdigit() and len(text) <= _MOST_DIGITS):
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number from 0 on")
    return int(text)


def seconds(text: str) -> float:
    """The time that is written there, s."""
    try:
        time = float(text)
    except ValueError:
        time = math.nan
    if not math.isfinite(time):
        raise argparse.ArgumentTypeError(f"{text!r} is no number of seconds")
    return time


def printable_scene(scene: Scene) -> Scene:
    """The same world with printable names."""
    return dataclasses.replace(
        scene,
        action_names=tuple(map(printable, scene.action_names)),
        reward_terms=tuple(map(printable, scene.reward_terms)),
        tracks=tuple(dataclasses.replace(track, name=printable(track.name)) for track in scene.tracks),
    )


def printable_trace(trace: EpisodeTrace) -> EpisodeTrace:
    """The same episode in a world with printable names."""
    entries = {name: tuple(map(printable, entries)) for name, entries in trace.entries.items()}
    return dataclasses.replace(trace, scene=printable_scene(trace.scene), entries=entries)


def counted(count: int, noun: str) -> str:
    """A number of things in words: 1 episode, 2,000 episodes."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}"


def json_text(document: Any, indent: int | None = None) -> str:
    """JSON that every parser accepts: it has no numbers for NaN and the infinities, so these become null."""
    try:
        return json.dumps(document, indent=indent, allow_nan=False)
    except ValueError:
        return json.dumps(_finite(document), indent=indent, allow_nan=False)


def print_json(document: Any) -> None:
    """Prints one JSON document."""
    print(json_text(document, indent=2))


def aligned(headings: Sequence[str], rows: Sequence[Sequence[str]], text_from: int) -> Iterator[str]:
    """Yields the lines of a plain table, quickly even if there are many.

    Args:
        headings: of the columns.
        rows: what stands in them; may be anything that a log holds.
        text_from: index of the first column of text, which begins at its left; figures before it end at their right.
    """
    lines = [headings, *([printable(cell) for cell in row] for row in rows)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for line in lines:
        figures = [cell.rjust(width) for cell, width in zip(line, widths, strict=True)][:text_from]
        texts = [cell.ljust(width) for cell, width in zip(line, widths, strict=True)][text_from:]
        yield "  ".join([*figures, *texts]).rstrip()


def _finite(document: Any) -> Any:
    if isinstance(document, float):
        return document if math.isfinite(document) else None
    if isinstance(document, dict):
        return {key: _finite(value) for key, value in document.items()}
    if isinstance(document, list | tuple):
        return [_finite(value) for value in document]
    return document


def best_first(episode: Episode) -> float:
    """What to sort by to have the highest return first."""
    return math.inf if math.isnan(episode.episode_return) else -episode.episode_return


def choose_trace(log: Log, episode: int | None) -> EpisodeTrace:
    """The episode of this number; for None that with the highest return of all whose transitions the log has.

    Raises:
        LogError: the log does not have it, or has none.
        DamagedLogError: it is not an intact log.
    """
    ended = [message.episode for message in sorted(log.episodes(), key=best_first)]
    if episode is None:
        return read_trace(log, _first_recorded(log, ended))
    if not _is_recorded(log, episode):
        raise LogError(f"log '{log.path}': {_absence(episode, ended)}")
    return read_trace(log, episode)


def _first_recorded(log: Log, ended: list[int]) -> int:
    """The first of the ended episodes that has transitions, most often the very first."""
    if ended and _is_recorded(log, ended[0]):
        return ended[0]
    recorded = _recorded(log)
    if not recorded:
        raise LogError(f"log '{log.path}': holds no transitions; give the log of a run that recorded some")
    for episode in ended:
        if episode in recorded:
            return episode
    raise LogError(
        f"log '{log.path}': no episode in it is recorded up to its end; "
        f"choose an unfinished one, such as --episode {min(recorded)}"
    )


def _is_recorded(log: Log, episode: int) -> bool:
    return next(log.batches(Selection(episodes=[episode])), None) is not None


def _recorded(log: Log) -> set[int]:
    """Every episode of which the log has a transition."""
    return {int(episode) for columns in log.batches() for episode in np.unique(columns["episode"])}


def _absence(episode: int, ended: list[int]) -> str:
    """Why an episode cannot be shown, and which can."""
    if episode in ended:
        return (
            f"notes the end of episode {episode} but has no transition of it, for recorder.envs or "
            "recorder.every_nth_episode left it out, or it lies in another part of the log; choose another one"
        )
    if not ended:
        return f"has no transition of episode {episode}, nor did any episode end in it"
    return f"has no episode {episode}; those that ended are in {min(ended)}..{max(ended)}, see carrl log ls FILE"


def transition_rows(columns: Columns, schema: Schema) -> Iterator[dict[str, Any]]:
    """Yields a dictionary for each transition, with lists of numbers in it where a column has a width above 1."""
    names = [column.name for column in schema.columns]
    values = [_listed(column, columns[column.name]) for column in schema.columns]
    for row in zip(*values, strict=True):
        yield dict(zip(names, row, strict=True))


def _listed(column: Column, values: NDArray[np.generic]) -> list[Any]:
    found: list[Any] = (values[:, 0] if column.shape == (1,) else values).tolist()
    return found
