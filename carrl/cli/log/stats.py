"""`carrl log stats`: what all episodes of a log add up to."""

import argparse
import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carrl.cli.log.shared import Verbs, add_json, add_verb, check_output, print_json, printable_scene
from carrl.errors import CarrlError, DamagedLogError, LogError
from carrl.log.messages import Episode
from carrl.log.reader import Log
from carrl.log.scene import Scene
from carrl.log.trace import action_choices, read_scene, with_choices
from carrl.report.log_stats import CONTROL_EDGES, GREATEST_RETURN, LogStats, count_controls, section_name


def add_to(verbs: Verbs) -> None:
    """Adds the verb."""
    description = "Tells how far the episodes came, how they ended, which actions were chosen, and where cars crashed."
    verb = add_verb(verbs, "stats", run, "returns, lengths, actions and crashes of all episodes", description)
    verb.add_argument("--png", type=Path, metavar="OUT.png", help="also draw them; an older picture is replaced")
    add_json(verb)


def run(arguments: argparse.Namespace) -> int:
    """Prints the statistics, and draws them if asked to."""
    picture, source = arguments.png, Path(arguments.file)
    if picture is not None and picture.suffix.lower() != ".png":
        raise CarrlError(f"--png is '{picture}'; the picture is a PNG, so its name must end in .png")
    if picture is not None:
        check_output(picture, source)
    with Log(source) as log:
        stats = _read_stats(log)
    if picture is not None:
        _draw(picture, stats, f"{source.resolve().parent.name}/{source.name}")
    if arguments.json:
        print_json(_document(stats))
    else:
        _print(stats)
    return 0


def _draw(path: Path, stats: LogStats, title: str) -> None:
    from carrl.report.log_stats_figure import draw_log_stats

    draw_log_stats(path, stats, title)


def _print(stats: LogStats) -> None:
    from carrl.cli.text.log_stats_text import print_log_stats
    from carrl.cli.text.terminal_table import TextConsole

    print_log_stats(dataclasses.replace(stats, scene=printable_scene(stats.scene)), TextConsole())


def _read_stats(log: Log) -> LogStats:
    """Gathers what the statistics need, holding no more than a chunk of transitions at a time.

    Raises:
        DamagedLogError: the log does not describe its world, or speaks of actions or places outside it.
    """
    scene = with_choices(read_scene(log))
    episodes = list(log.episodes())
    counts, random_choices = np.zeros(len(scene.action_names), dtype=np.int64), 0
    controls: NDArray[np.int64] | None = None
    for batch in log.coded_batches():
        actions = action_choices(batch.columns)
        if actions.min() < 0 or actions.max() >= len(counts):
            raise DamagedLogError(f"log '{log.path}': has an action without a name; give the log of a carrl train run")
        counts += np.bincount(actions, minlength=len(counts))
        if batch.columns["action"].dtype.kind == "f":
            each = count_controls(_finite_controls(log, batch.columns["action"], len(scene.control_names)))
            controls = each if controls is None else controls + each
        random_choices += int(np.count_nonzero(batch.columns.get("exploratory", 0)))
    _check_episodes(log, episodes, scene)
    share = random_choices / max(1, int(counts.sum())) if "exploratory" in log.schema.by_name else math.nan
    return LogStats.of(episodes, scene, counts, share, controls)


def _finite_controls(log: Log, actions: NDArray[Any], count: int) -> NDArray[Any]:
    """Actions that are numbers, [T, C].

    Raises:
        DamagedLogError: they are not one finite number for each control.
    """
    controls = actions.reshape(len(actions), -1)
    if controls.shape[1] != count or not np.isfinite(controls).all():
        raise DamagedLogError(
            f"log '{log.path}': has an action that is not one number for each of {count} controls; "
            "give the log of a carrl train run"
        )
    return controls


def _check_episodes(log: Log, episodes: Sequence[Episode], scene: Scene) -> None:
    """Raises an error unless each episode ended somewhere on an attached track, with a return that can be summed."""
    for episode in episodes:
        if not 0 <= episode.track < len(scene.tracks):
            raise DamagedLogError(
                f"log '{log.path}': episode {episode.episode} ended on track {episode.track}, which is not attached; "
                "give the log of a carrl train run"
            )
        if not abs(episode.episode_return) <= GREATEST_RETURN or not all(map(math.isfinite, episode.end_pose)):
            x, y, _ = episode.end_pose
            raise LogError(
                f"log '{log.path}': episode {episode.episode} has the return {episode.episode_return:g} and ended at "
                f"{x:g} {y:g}; statistics need returns up to {GREATEST_RETURN:g} and finite places; see carrl log ls"
            )


def _document(stats: LogStats) -> dict[str, Any]:
    total = int(stats.action_counts.sum())
    return {
        "transitions": total,
        "exploratory_share": stats.exploratory_share,
        **_actions(stats, total),
        "episodes_ended": len(stats),
        "ended": stats.ends_counted,
        "laps": int(stats.laps.sum()),
        "episodes_lapped": int(np.count_nonzero(stats.laps)),
        "episode_return": _spread(stats.returns),
        "length": _spread(stats.lengths),
        "crashes": _crashes(stats) if len(stats) else None,
    }


def _actions(stats: LogStats, total: int) -> dict[str, Any]:
    """How often each action was chosen, or where they are numbers, how often each control lay where."""
    if stats.control_counts is None:
        counts = zip(stats.scene.action_names, stats.action_counts.tolist(), strict=True)
        return {"actions": {name: {"count": count, "share": count / max(1, total)} for name, count in counts}}
    counts = zip(stats.scene.control_names, stats.control_counts.tolist(), strict=True)
    return {"controls": {name: {"edges": CONTROL_EDGES.tolist(), "counts": count} for name, count in counts}}


def _spread(values: NDArray[Any]) -> dict[str, float] | None:
    """The figures that describe one value for each episode; None without episodes."""
    if not len(values):
        return None
    low, quarter, median, three_quarters, high = np.quantile(values, [0, 0.25, 0.5, 0.75, 1]).tolist()
    return {
        "mean": float(values.mean()),
        "min": low,
        "quartile_1": quarter,
        "median": median,
        "quartile_3": three_quarters,
        "max": high,
    }


def _crashes(stats: LogStats) -> dict[str, Any]:
    """How many cars crashed between which gates of the track with the most episodes."""
    gates = len(stats.track.gates)
    sections = enumerate(stats.crashes_by_section.tolist())
    return {
        "track_name": stats.track.name,
        "off_the_map": stats.off_the_map,
        "sections": [{"between": section_name(section, gates), "count": count} for section, count in sections],
    }
