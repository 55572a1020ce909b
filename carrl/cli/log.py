"""`carrl log`: looks into a run's MCAP log."""

import argparse
import dataclasses
import json
from collections.abc import Sequence
from typing import Any

from carrl.log import LogSummary, read_summary
from carrl.record.schema import COLUMNS


def main(argv: list[str]) -> int:
    """Runs one verb of `carrl log` and returns the exit code."""
    parser = argparse.ArgumentParser(prog="carrl log", description="look into a run's MCAP log")
    verbs = parser.add_subparsers(metavar="VERB", required=True)
    info = verbs.add_parser("info", help="what is in the file", description="show what is in a log")
    info.add_argument("file", metavar="FILE", help="a log, such as train.mcap in a run's folder")
    info.add_argument("--json", action="store_true", help="print one JSON document and nothing else")
    info.set_defaults(run=_info)
    arguments = parser.parse_args(argv)
    return int(arguments.run(arguments))


def _info(arguments: argparse.Namespace) -> int:
    summary = read_summary(arguments.file)
    if arguments.json:
        print(json.dumps(_as_json(summary), indent=2))
    else:
        _print_tables(summary)
    return 0


def _as_json(summary: LogSummary) -> dict[str, Any]:
    document = dataclasses.asdict(summary) | {
        "path": str(summary.path),
        "time_span_s": summary.time_span_s,
        "bytes_per_transition": summary.bytes_per_transition,
    }
    shapes = document.pop("row_shapes")
    document["columns"] = {c.name: {"dtype": c.dtype, "shape": shapes[c.name]} for c in COLUMNS}
    return document


def _print_tables(summary: LogSummary) -> None:
    from rich.console import Console
    from rich.table import Table

    def print_table(title: str, headings: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> None:
        table = Table(title=title, title_justify="left", show_header=any(headings))
        for heading in headings:
            table.add_column(heading, overflow="fold")
        for row in rows:
            table.add_row(*row)
        console.print(table)

    console = Console(markup=False, highlight=False, emoji=False)  # "[3]" is a shape here, not a style
    print_table(str(summary.path), ("", ""), _totals(summary))
    print_table("topics", ("topic", "messages", "bytes per transition, unpacked"), _topics(summary))
    print_table("columns", ("column", "type", "shape", "meaning"), _columns(summary))
    print_table("attachments", ("name", "bytes"), [(name, f"{size:,}") for name, size in summary.attachments.items()])
    others = [(key, value) for key, value in summary.metadata.items() if not key.startswith("column.")]
    print_table("metadata", ("key", "value"), others)


def _totals(summary: LogSummary) -> list[tuple[str, ...]]:
    each = f" ({summary.bytes_per_transition:.1f} per transition)" if summary.bytes_per_transition else ""
    span = f"{summary.start_time_s:,.1f} to {summary.end_time_s:,.1f} s" if summary.transitions else "none"
    return [
        ("format version", str(summary.format_version)),
        ("transitions", f"{summary.transitions:,}"),
        ("episodes ended", f"{summary.episodes_ended:,}"),
        ("simulated time", span),
        ("bytes on disk", f"{summary.file_bytes:,}{each}"),
    ]


def _topics(summary: LogSummary) -> list[tuple[str, ...]]:
    count = max(1, summary.transitions)
    return [
        (name, f"{topic.messages:,}", f"{topic.message_bytes / count:.1f}") for name, topic in summary.topics.items()
    ]


def _columns(summary: LogSummary) -> list[tuple[str, ...]]:
    return [(c.name, c.dtype, str(list(summary.row_shapes[c.name])), c.meaning) for c in COLUMNS]
