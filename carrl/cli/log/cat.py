"""`carrl log cat`: messages one by one, as lines for people or as JSON lines for programs."""

import argparse
import math
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

from carrl.cli.log.shared import (
    Verbs,
    add_json,
    add_selection,
    add_verb,
    counted,
    json_text,
    selection_of,
    transition_rows,
    whole_number,
)
from carrl.errors import DamagedLogError, LogError, printable
from carrl.log.codec import EVERYTHING, Selection
from carrl.log.messages import Episode, Metrics
from carrl.log.reader import Log
from carrl.log.schema import EPISODES, MESSAGE_NAMES, METRICS, TRANSITIONS
from carrl.log.trace import read_scene

_LABELS = {"action_value": "Q"}
_FIGURES = {"td_error": "TD error", "action_value": "Q"}
_UNSHOWN = ("epsilon", "exploratory")
"""Columns of the algorithm that have no place of their own in a line."""


def add_to(verbs: Verbs) -> None:
    """Adds the verb."""
    description = (
        "Prints a line for each transition, ended episode or message of metrics. With --begin or --end it prints the "
        "episodes that were under way then."
    )
    verb = add_verb(verbs, "cat", run, "transitions, episodes or metrics, a line each", description)
    verb.add_argument(
        "--topic", choices=MESSAGE_NAMES, default=TRANSITIONS, help="which messages (default %(default)s)"
    )
    add_selection(verb)
    verb.add_argument("--limit", type=whole_number, metavar="N", help="only the first so many")
    add_json(verb, "print each line as a JSON object; NaN and the infinities, which JSON lacks, are null")


def run(arguments: argparse.Namespace) -> int:
    """Prints the messages asked for, holding no more than some thousands of them."""
    selection = selection_of(arguments)
    with Log(Path(arguments.file)) as log:
        lines = _json_lines if arguments.json else _text_lines
        for line in islice(lines(log, arguments.topic, selection), arguments.limit):
            print(line)
    return 0


def _json_lines(log: Log, topic: str, selection: Selection) -> Iterator[str]:
    if topic == TRANSITIONS:
        return (json_text(row) for columns in log.batches(selection) for row in transition_rows(columns, log.schema))
    small = _small_messages(log, topic, selection)
    return (json_text(each.row() if isinstance(each, Metrics) else each._asdict()) for each in small)


def _text_lines(log: Log, topic: str, selection: Selection) -> Iterator[str]:
    if topic == TRANSITIONS:
        actions, names = _action_names(log), [column.name for column in log.schema.algorithm]
        rows = (row for columns in log.batches(selection) for row in transition_rows(columns, log.schema))
        controls = log.schema.by_name["action"].entries
        return (_transition_line(row, actions or controls, names) for row in rows)
    return (
        _episode_line(message) if isinstance(message, Episode) else _metrics_line(message)
        for message in _small_messages(log, topic, selection)
    )


def _small_messages(log: Log, topic: str, selection: Selection) -> Iterator[Episode | Metrics]:
    if topic == EPISODES:
        yield from (episode for episode in log.episodes() if _is_selected(episode, selection))
        return
    if selection != EVERYTHING:
        raise LogError(
            f"--episode, --env, --begin and --end choose episodes, cars and times; {METRICS} has none of them"
        )
    yield from log.metrics()


def _is_selected(episode: Episode, selection: Selection) -> bool:
    begin, end = selection.span_ns
    return (
        (selection.episodes is None or episode.episode in selection.episodes)
        and (selection.envs is None or episode.env in selection.envs)
        and episode.begin_ns < end
        and episode.end_ns > begin
    )


def _action_names(log: Log) -> Sequence[str]:
    """What the actions are called; none if the log does not say."""
    try:
        return [printable(name) for name in read_scene(log).action_names]
    except DamagedLogError:
        return []


def _transition_line(row: dict[str, Any], actions: Sequence[str], algorithm: Sequence[str]) -> str:
    x, y, heading = row["state"][:3]
    end = "  terminated" * row["terminated"] + "  truncated" * row["truncated"]
    others = [f"  {_LABELS.get(name, name)} {_joined(row[name], '.1f')}" for name in algorithm if name not in _UNSHOWN]
    return (
        f"{row['time_ns'] / 1e9:.2f} s  episode {row['episode']} step {row['step']} car {row['car']}  "
        f"{_action(row['action'], actions)}{' (random)' * row.get('exploratory', False)}  reward {row['reward']:g}  "
        f"at {x:.2f} {y:.2f} heading {math.degrees(heading):.0f}°  "
        f"observed {_joined(row['observation'], '.2f')}{''.join(others)}{end}"
    )


def _action(action: Any, names: Sequence[str]) -> str:
    """Its name, or the controls that it is."""
    if not isinstance(action, int):
        values = action if isinstance(action, list) else [action]
        if len(names) == len(values):
            return " ".join(f"{printable(name)} {value:+.2f}" for name, value in zip(names, values, strict=True))
        return f"action {_joined(action, '.2f')}"
    return names[action] if 0 <= action < len(names) else f"action {action}"


def _episode_line(episode: Episode) -> str:
    x, y, _ = episode.end_pose
    return (
        f"{episode.end_ns / 1e9:.2f} s  episode {episode.episode} car {episode.env}: "
        f"{counted(episode.length, 'step')}, return {episode.episode_return:g}, {counted(episode.gates, 'gate')}, "
        f"{counted(episode.laps, 'lap')}, {episode.ended} at {x:.2f} {y:.2f}"
    )


def _metrics_line(metrics: Metrics) -> str:
    return (
        f"frame {metrics.frame}: {counted(metrics.updates, 'update')}, loss {metrics.loss:.4g}, "
        f"{''.join(f'{_FIGURES.get(name, printable(name))} {value:.4g}, ' for name, value in metrics.figures.items())}"
        f"{metrics.frames_per_second:,.0f} frames/s"
    )


def _joined(values: float | Sequence[float], how: str) -> str:
    return " ".join(format(value, how) for value in (values if isinstance(values, list) else [values]))
