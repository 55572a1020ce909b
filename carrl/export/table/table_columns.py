"""How the columns of a log become the columns of a table, which has one value in each of its cells.

Shape letters: `T` transitions.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carrl.log.reader import Log
from carrl.log.schema import Column

_UNITS = {
    **{
        f"{prefix}{name}": unit
        for prefix in ("state_", "next_state_")
        for name, unit in (("x", "m"), ("y", "m"), ("heading", "rad"))
    },
    "time_ns": "ns",
}


@dataclass(frozen=True)
class TableColumn:
    """One column of the table.

    Attributes:
        name: its heading, such as `state_x`.
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

    A column of one value keeps its name; one of several has its entry's name after its own: `state_x`,
    `action_value_left`, `reward_gate`; or its entry's number where entries have no names: `observation_0`.
    """
    return [table_column for column in log.schema.columns for table_column in _columns_of(column)]


def _columns_of(column: Column) -> list[TableColumn]:
    if column.shape == ():
        return [TableColumn(column.name, column, None)]
    names: Sequence[str] = column.entries
    if column.width == 1 and not names:
        return [TableColumn(column.name, column, 0)]
    if len(set(names)) != column.width:
        names = [str(index) for index in range(column.width)]
    stem = "reward" if column.name == "reward_terms" else column.name
    return [TableColumn(f"{stem}_{name}", column, index) for index, name in enumerate(names)]
