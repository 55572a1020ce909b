"""The policy as plain arrays in a file of NumPy's, whose metadata says how they follow each other."""

import json
from pathlib import Path

import numpy as np

from carrl.export.policy.graph import PolicyGraph

METADATA = "metadata"


def write_arrays(path: Path, graph: PolicyGraph) -> None:
    """Writes the arrays by their names, and the document as JSON in the array `metadata`."""
    with path.open("wb") as file:  # given a name, NumPy appends an ending
        np.savez(file, allow_pickle=False, **{METADATA: np.array(json.dumps(graph.document))}, **graph.arrays)
