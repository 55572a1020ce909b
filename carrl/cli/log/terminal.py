"""What the verbs print without rich: counts, plain tables, JSON."""

import json
import math
from collections.abc import Iterator, Sequence
from typing import Any

from carrl.cli.log.printable import printable


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
