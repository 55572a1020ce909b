"""How the columns of a log become the columns of a table, which has one value in each of its cells.

Shape letters: `T` transitions.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carrl.errors import DamagedLogError
from carrl.log.reader import Log
from carrl.log.schema import COLUMNS, Column
from carrl.log.trace import read_scene

_UNITS = {"pose_x": "m", "pose_y": "m", "pose_heading": "rad", "time_ns": "ns"}


@dataclass(frozen=True)
class TableColumn:
    """One column of the table.

    Attributes:
        name: its heading, such as `pose_x`.
        source: the log's column that it is taken from.
        index: of the value within a transition's row of values; None if the log has one value for each transition.
    """

    name: str
    source: Column
    index: int | None

    @property
    def unit(self) -> str:
        """In which its values are; 1 for plain numbers."""
        return _UNITS.get(self.name, "1")

    def values(self, columns: Mapping[str, NDArray[np.generic]]) -> NDArray[np.generic]:
        """Its values in these columns of a log, [T]."""
        found = columns[self.source.name]
        return found if self.index is None else found[:, self.index]


def table_columns(log: Log) -> list[TableColumn]:
    """The columns of a log's table, in the order of the log's.

    A column of one value keeps its name; one of several has its part's name after its own: `pose_x`,
    `action_value_left`, `reward_gate`; or its part's number where parts have no names: `observation_0`.
    """
    parts, shapes = _part_names(log), log.row_shapes
    return [
        table_column
        for column in COLUMNS
        for table_column in _columns_of(column, shapes[column.name], parts.get(column.name, ()))
    ]


def _columns_of(column: Column, shape: tuple[int, ...], names: Sequence[str]) -> list[TableColumn]:
    if shape == ():
        return [TableColumn(column.name, column, None)]
    if column.shape == (1,):
        return [TableColumn(column.name, column, 0)]
    (width,) = shape
    if len(names) != width or len(set(names)) != width:
        names = [str(index) for index in range(width)]
    stem = "reward" if column.name == "reward_terms" else column.name
    return [TableColumn(f"{stem}_{name}", column, index) for index, name in enumerate(names)]


def _part_names(log: Log) -> dict[str, Sequence[str]]:
    """What the values of a row are called, by column, so far as the log says."""
    names: dict[str, Sequence[str]] = {"pose": ("x", "y", "heading")}
    try:
        scene = read_scene(log)
    except DamagedLogError:
        return names
    return names | {"action_value": scene.action_names, "reward_terms": scene.reward_terms}
