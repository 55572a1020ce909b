"""`carrl log info`: what is in a log, and of which run."""

import argparse
import dataclasses
import json
import math
from collections.abc import Mapping
from typing import Any

from carrl.cli.log.shared import Verbs, add_json, add_verb, print_json
from carrl.log import Column, LogSummary, read_summary, version2
from carrl.log.log_file import ATTACHMENT, CHECKSUM
from carrl.log.scene import Scene

_RUN = {"seed": "seed", "track": "track", "num_envs": "cars", "git_commit": "commit"}
"""Entries of the metadata that the first table shows, and what it calls them."""


def add_to(verbs: Verbs) -> None:
    """Adds the verb."""
    description = "Tells what is in a log and of which run it is, in the same time however large it is."
    add_json(add_verb(verbs, "info", run, "what is in a log, and of which run it is", description))


def run(arguments: argparse.Namespace) -> int:
    """Prints the log's summary."""
    summary = read_summary(arguments.file)
    if arguments.json:
        print_json(_document(summary))
    else:
        _print_tables(summary)
    return 0


def _document(summary: LogSummary) -> dict[str, Any]:
    scene = _scene(summary.scene_entries)
    document = dataclasses.asdict(summary) | {
        "path": str(summary.path),
        "part": _parsed(summary.metadata, "part", int),
        "time_span_s": summary.time_span_s,
        "bytes_per_transition": summary.bytes_per_transition,
        "git_commit": summary.metadata.get("git_commit"),
        "packages": _parsed(summary.metadata, "packages", dict),
        "sensors": scene and {"angles_rad": scene.sensor_angles.tolist(), "range_m": scene.sensor_range},
    }
    del document["schema"], document["scene_entries"]
    document["columns"] = {column.pop("name"): column for column in json.loads(summary.schema.as_json())}
    document["lacks"] = version2.LACKS if summary.format_version == version2.VERSION else None
    return document


def _print_tables(summary: LogSummary) -> None:
    from carrl.cli.text.terminal_table import print_table

    columns = [(c.name, c.dtype, str(list(c.shape)), _meaning(c)) for c in summary.schema.columns]
    topics = [(name, f"{count:,}") for name, count in summary.messages.items()]
    attachments = [(name, f"{size:,}") for name, size in summary.attachments.items()]
    print_table(str(summary.path), ("", ""), [*_totals(summary), *_run_rows(summary)], figures=())
    print_table("topics", ("topic", "messages"), topics)
    print_table("columns", ("column", "type", "shape", "meaning"), columns, figures=())
    print_table("attachments", ("name", "bytes"), attachments)
    print_table("metadata", ("key", "value"), _other_entries(summary.metadata), figures=())


def _totals(summary: LogSummary) -> list[tuple[str, str]]:
    each = f" ({summary.bytes_per_transition:.1f} per transition)" if summary.bytes_per_transition else ""
    span = f"{summary.start_time_s:,.1f} to {summary.end_time_s:,.1f} s" if summary.transitions else "none"
    return [
        ("format version", str(summary.format_version)),
        *([("lacks", version2.LACKS)] if summary.format_version == version2.VERSION else []),
        ("part", summary.metadata.get("part", "unknown")),
        ("transitions", f"{summary.transitions:,}"),
        ("episodes ended", f"{summary.episodes_ended:,}"),
        ("simulated time", span),
        ("bytes on disk", f"{summary.file_bytes:,}{each}"),
    ]


def _run_rows(summary: LogSummary) -> list[tuple[str, str]]:
    """What the run says of itself, so far as it does."""
    metadata = summary.metadata
    rows = [(name, metadata[key]) for key, name in _RUN.items() if key in metadata]
    packages = _parsed(metadata, "packages", dict)
    if packages:
        rows.append(("packages", ", ".join(f"{name} {version}" for name, version in packages.items())))
    scene = _scene(summary.scene_entries)
    if scene and len(scene.sensor_angles):
        first, last = (math.degrees(angle) for angle in (scene.sensor_angles.min(), scene.sensor_angles.max()))
        sensors = f"{len(scene.sensor_angles)} rays, {first:.0f}° to {last:.0f}°, range {scene.sensor_range:g} m"
        rows += [
            ("sensors", sensors),
            ("actions", ", ".join(scene.action_names) or f"numbers for {', '.join(scene.control_names)}"),
            ("time step", f"{scene.time_step:g} s"),
        ]
    return rows


def _meaning(column: Column) -> str:
    """What the values are, and what those of a row are called."""
    return f"{column.meaning}: {', '.join(column.entries)}" if column.entries else column.meaning


def _other_entries(metadata: Mapping[str, str]) -> list[tuple[str, str]]:
    """Those that no other table shows."""
    shown = {"format_version", "part", "packages", CHECKSUM, *_RUN}
    return [
        (key, value)
        for key, value in metadata.items()
        if key not in shown and not key.startswith(("column.", ATTACHMENT))
    ]


def _scene(metadata: Mapping[str, str]) -> Scene | None:
    try:
        return Scene.from_entries(metadata, ())
    except ValueError:  # the log of another program than carrl train
        return None


def _parsed(metadata: Mapping[str, str], key: str, kind: type) -> Any:
    """An entry that should be JSON; None if it is missing, or something else."""
    try:
        found = json.loads(metadata.get(key, ""))
    except (ValueError, RecursionError):
        return None
    return found if isinstance(found, kind) else None
