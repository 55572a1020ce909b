"""What a log says, bit for bit, and whether another one says a part of it.

Shape letters: `T` transitions.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from carrl.log.codec import Columns, encode_small
from carrl.log.messages import Episode, Metrics
from carrl.log.reader import Log
from carrl.log.schema import EPISODES, METRICS


@dataclass(frozen=True)
class LogContents:
    """What a log says, in a form that is equal only if every bit is.

    Attributes:
        run: its number, as the metadata has it.
        rows: the bytes of each transition's values, T of them, all different.
        episodes: the bytes of each message, without the run's number.
        metrics: likewise.
        attachments: contents by name.
        metadata: all entries.
    """

    run: str
    rows: list[bytes]
    episodes: list[bytes]
    metrics: list[bytes]
    attachments: dict[str, bytes]
    metadata: dict[str, str]


def read_contents(path: Path) -> LogContents:
    """Reads all that a log says.

    Raises:
        LogError: it is not an intact log.
    """
    with Log(path) as log:
        return LogContents(
            run=log.metadata["run"],
            rows=rows_of(log.columns()),
            episodes=[message_bytes(EPISODES, episode) for episode in log.episodes()],
            metrics=[message_bytes(METRICS, metrics) for metrics in log.metrics()],
            attachments={name: log.attachment(name) for name in log.attachments},
            metadata=dict(log.metadata),
        )


def rows_of(columns: Columns) -> list[bytes]:
    """The bytes of each transition, its columns one after the other."""
    count = len(columns["action"])
    parts = [np.ascontiguousarray(values).reshape(count, -1).view(np.uint8) for values in columns.values() if count]
    return [row.tobytes() for row in np.concatenate(parts, axis=1)] if count else []


def message_bytes(topic: str, message: Episode | Metrics) -> bytes:
    """The message as it is in a log, with 0 for the run's number; a NaN equals itself so."""
    return encode_small(topic, 0, message)


def places_in(original: Sequence[bytes], found: Sequence[bytes]) -> list[int] | None:
    """The index in the original of each item found; None unless they are some of its items, once each and in order."""
    places, begin = [], 0
    for item in found:
        try:
            begin = original.index(item, begin) + 1
        except ValueError:
            return None
        places.append(begin - 1)
    return places
