"""`carrl log show`: one episode on the terminal."""

import argparse
import re
from pathlib import Path
from typing import Any

from carrl.cli.log.shared import (
    Verbs,
    add_episode,
    add_json,
    add_verb,
    choose_trace,
    print_json,
    printable_trace,
    transition_rows,
)
from carrl.errors import LogError
from carrl.log.laps import recorded_laps
from carrl.log.reader import Log
from carrl.log.schema import Schema
from carrl.log.trace import EpisodeTrace

_STEPS = re.compile(r"(\d{0,9}):(\d{0,9})", re.ASCII)


def add_to(verbs: Verbs) -> None:
    """Adds the verb."""
    description = "Prints one episode: a map of the drive, its rewards and Q-values, and a table of its steps."
    verb = add_verb(verbs, "show", run, "one episode: map, rewards, Q-values, steps", description)
    add_episode(verb)
    steps = verb.add_mutually_exclusive_group()
    steps.add_argument(
        "--steps", type=step_span, metavar="A:B", help="steps from A on and before B; either may be left out"
    )
    steps.add_argument("--all", action="store_true", help="every step instead of the first and the last ones")
    add_json(verb, "print the episode and these of its transitions, all by default, as one JSON document")


def run(arguments: argparse.Namespace) -> int:
    """Prints the episode."""
    with Log(Path(arguments.file)) as log:
        trace, schema = choose_trace(log, arguments.episode), log.schema
    rows = _rows(trace, arguments)
    if arguments.json:
        print_json(_document(trace, rows or range(len(trace)), schema))
    else:
        _print(trace, rows)
    return 0


def step_span(text: str) -> tuple[int, int | None]:
    """The first step and the one after the last; None for all that follow."""
    match = _STEPS.fullmatch(text)
    if match is None:
        raise argparse.ArgumentTypeError(f"{text!r} is no span of steps; write it as 20:40, 20: or :40")
    return int(match[1] or 0), int(match[2]) if match[2] else None


def _rows(trace: EpisodeTrace, arguments: argparse.Namespace) -> range | None:
    """Which rows of the trace are asked for; None if that is left open.

    Raises:
        LogError: none of the episode's steps.
    """
    if arguments.steps is None:
        return range(len(trace)) if arguments.all else None
    first, end = arguments.steps
    steps = trace.columns["step"]
    begin_row, end_row = steps.searchsorted([first, steps[-1] + 1 if end is None else end])
    if begin_row >= end_row:
        raise LogError(f"--steps asks for none of the steps of episode {trace.episode}, {steps[0]}..{steps[-1]}")
    return range(begin_row, end_row)


def _document(trace: EpisodeTrace, rows: range, schema: Schema) -> dict[str, Any]:
    columns = {name: values[rows.start : rows.stop] for name, values in trace.columns.items()}
    return {
        "episode": trace.episode,
        "car": trace.car,
        "track_name": trace.track.name,
        "first_step": trace.first_step,
        "length": len(trace),
        "episode_return": float(trace.rewards.sum()),
        "gates": int(trace.gates_passed[-1]),
        "laps": [
            {"step": int(trace.columns["step"][lap.row]), "time_s": round(lap.seconds, 3), "counts": bool(lap.counts)}
            for lap in recorded_laps(trace)
        ],
        "ended": trace.ended,
        "action_names": trace.scene.action_names,
        "reward_terms": trace.scene.reward_terms,
        "transitions": list(transition_rows(columns, schema)),
    }


def _print(trace: EpisodeTrace, rows: range | None) -> None:
    from carrl.cli.text.episode_text import print_episode
    from carrl.cli.text.terminal_table import TextConsole

    print_episode(printable_trace(trace), TextConsole(), rows)
