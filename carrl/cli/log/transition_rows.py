"""Transitions one by one, as Python values with the names of the log's columns."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carrl.log.codec import Columns
from carrl.log.schema import Column, Schema


def transition_rows(columns: Columns, schema: Schema) -> Iterator[dict[str, Any]]:
    """Yields a dictionary for each transition, with lists of numbers in it where a column has a width above 1."""
    names = [column.name for column in schema.columns]
    values = [_listed(column, columns[column.name]) for column in schema.columns]
    for row in zip(*values, strict=True):
        yield dict(zip(names, row, strict=True))


def _listed(column: Column, values: NDArray[np.generic]) -> list[Any]:
    found: list[Any] = (values[:, 0] if column.shape == (1,) else values).tolist()
    return found
