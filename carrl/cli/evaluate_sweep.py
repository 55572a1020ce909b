"""`carrl evaluate SWEEP`: the runs of a folder, each evaluated as it would be alone."""

import argparse
import sys
from collections.abc import Sequence
from typing import Any

from carrl.cli.limits import limits_for
from carrl.cli.text.console import warn
from carrl.errors import CarrlError, printable
from carrl.report.runs import RunResult
from carrl.train.experiment import road_warning
from carrl.train.run import Run, load_tracks


def evaluate_sweep(arguments: argparse.Namespace, runs: Sequence[RunResult]) -> dict[str, Any]:
    """The evaluations of those runs that have finished, and why the others are left out.

    Raises:
        CarrlError: none has finished, or one cannot be evaluated.
    """
    folder = arguments.run[0]
    left_out = {run.label: run.reason for run in runs if not run.counts}
    for label, reason in left_out.items():
        print(printable(f"warning: left out '{label}': {reason}"), file=sys.stderr)
    finished = [run for run in runs if run.counts]
    if not finished:
        raise CarrlError(f"no run in '{folder}' has finished; name one to evaluate it as it is")
    tracks, refused = load_tracks(arguments.track)
    for path, reason in refused.items():
        print(printable(f"warning: left out '{path}': {reason}"), file=sys.stderr)
    documents, warned = [], set[str | None]()
    for number, result in enumerate(finished, start=1):
        print(printable(f"[{number}/{len(finished)}] {result.label}"), file=sys.stderr)
        run = Run.load(result.folder, arguments.trust)
        sentence = road_warning(tracks or run.world.circuits.validation, run.world)
        if sentence not in warned:
            warn(sentence)
            warned.add(sentence)
        document = run.evaluate(
            tracks,
            arguments.starts,
            arguments.policy,
            arguments.checkpoint or "best",
            arguments.laps,
            limits=limits_for(arguments, tracks or run.world.circuits.validation, run.world.vehicle),
        )
        documents.append(document | {"run": result.label, "folder": str(result.folder)})
    return {
        "sweep": folder,
        "policy": arguments.policy,
        "runs": documents,
        **({"left_out": left_out} if left_out else {}),
        **({"refused": refused} if refused else {}),
    }
