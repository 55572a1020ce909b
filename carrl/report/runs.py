"""Finds finished and unfinished runs."""

import os
import re
from pathlib import Path

from carrl.errors import CheckpointError
from carrl.report.reading import RunResult, read_run
from carrl.train.files import CONFIG


def find_runs(roots: list[Path]) -> list[RunResult]:
    """Every run below the folders, those in progress or broken off included, in the natural order of their paths.

    Raises:
        CheckpointError: there is none in one of them.
    """
    runs = {root: {config.parent.parent for config in root.rglob(str(CONFIG))} for root in roots if os.path.isdir(root)}
    empty = [root for root in roots if not runs.get(root)]
    if empty:
        names = ", ".join(f"'{root}'" for root in empty)
        raise CheckpointError(f"no run in {names}; name folders that `carrl train` has written")
    found = set().union(*runs.values())
    found -= {folder.parent for folder in found}  # a run of several seeds holds one folder for each
    folders = sorted(found, key=in_natural_order)
    return [read_run(folder, label) for folder, label in zip(folders, _labels(folders), strict=True)]


def in_natural_order(folder: Path) -> list[tuple[str, int]]:
    """A key that puts seed=2 before seed=10."""
    return [(text, int(digits or 0)) for text, digits in re.findall(r"(\D*)(\d*)", str(folder))]


def _labels(folders: list[Path]) -> list[str]:
    """The parts of the folders' names in which they differ: seed=3 of seed=3,trainer.frames=100000.

    Where their own names do not tell them apart, those of the folders above them are added.
    """
    labels: list[str] = []
    for depth in range(1, max(len(folder.parts) for folder in folders) + 1):
        words = [[word for part in folder.parts[-depth:] for word in part.split(",")] for folder in folders]
        common = set.intersection(*map(set, words)) if len(folders) > 1 else set()
        labels = [",".join(word for word in own if word not in common) for own in words]
        if len(set(labels)) == len(labels):
            break
    return [label or folder.name for label, folder in zip(labels, folders, strict=True)]
