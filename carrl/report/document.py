"""A report as files: one JSON document and tables for machines, beside the text and its figures."""

import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

from carrl.errors import CarrlError
from carrl.evaluation.results import Rollout
from carrl.files import write_whole
from carrl.report.findings import SIGNIFICANCE, Comparison, Findings, GroupFigure, lapped
from carrl.report.groups import Group
from carrl.report.measures import CONFIDENCE, RESAMPLES, SEED, Estimate, measures_of
from carrl.report.runs import RunResult
from carrl.report.text import Picture, comma_separated, report_text

RUN_FIGURES = ("episodes", "frames", "updates", "wall_time_s")
REPORT, DOCUMENT, RUNS, GROUPS = "report.md", "report.json", "runs.csv", "groups.csv"
RETURNS = Picture("learning_curves.png", "Return against frames: interquartile mean of the runs, with its 95 % band")
TRIALS = Picture(
    "evaluation_curves.png",
    "Laps, and speed or reward, of the networks that were tried out: each run, and their interquartile mean",
)
PROFILES = Picture(
    "performance_profile.png", "Share of the runs that have lapped, and that end above a return, with 95 % bands"
)
IMPROVEMENT = Picture("improvement.png", "Probability of improvement by each measure, with its 95 % interval")
FIRST_LAPS = Picture(
    "first_lap.png", "First greedy lap of each run; below, the interquartile mean with its 95 % interval"
)
SMOOTHNESS = Picture(
    "smoothness.png", "Smoothness of each run's best lap; below, the interquartile mean with its 95 % interval"
)


def as_json(findings: Findings, best_lap: Rollout | None = None) -> str:
    """The report as one JSON document; a figure that does not exist is null."""
    document = {
        "problems": [problem.as_dict() for problem in findings.problems],
        "groups": [_group(group, figures) for group, figures in zip(findings.groups, findings.figures, strict=True)],
        "comparisons": [_comparison(comparison) for comparison in findings.comparisons],
        "significant": [str(comparison) for comparison in findings.significant],
        "runs_needed": findings.runs_needed,
        "runs": [_run(run, findings) for run in findings.runs],
        "best_lap": None if best_lap is None else best_lap.measures(),
        "method": {
            "figure": "interquartile mean",
            "interval": "percentiles of a bootstrap stratified by group",
            "confidence": CONFIDENCE,
            "resamples": RESAMPLES,
            "test": "exact two-sided Mann-Whitney, Holm's correction for all pairs of a measure",
            "significance": SIGNIFICANCE,
            "seed": SEED,
        },
    }
    return json.dumps(document, indent=2, allow_nan=False)


def runs_csv(findings: Findings) -> str:
    """A row for each run, whether it counts or not."""
    rows = [_run(run, findings) for run in findings.runs]
    return comma_separated(list(rows[0]), [list(row.values()) for row in rows])


def groups_csv(findings: Findings) -> str:
    """A row for each group, with an interquartile mean, its interval and its count for each measure."""
    measures = measures_of(findings.runs)
    header = ["group", "runs", "lapped"]
    header += [f"{measure.key}{part}" for measure in measures for part in ("", "_low", "_high", "_runs", "_never")]
    rows = []
    for group, figures in zip(findings.groups, findings.figures, strict=True):
        row: list[object] = [group.label, len(group.counted), lapped(group)]
        for measure in measures:
            figure = figures.get(measure.key)
            row += [None] * 3 + [0, 0] if figure is None else [*_estimate(figure.estimate), figure.runs, figure.never]
        rows.append(row)
    return comma_separated(header, rows)


def _run(run: RunResult, findings: Findings) -> dict[str, Any]:
    group = next((each for each in findings.groups if run in each.runs), None)
    summary = run.summary or {}
    measures = measures_of(findings.runs)
    values = {measure.key: measure.value(run) if run.summary else None for measure in measures}
    return {
        "run": run.label,
        "folder": str(run.folder),
        "group": group.label if group else None,
        "seed": run.seed,
        "state": run.state,
        "counted": bool(group and run in group.counted),
        **{name: summary.get(name) for name in RUN_FIGURES},
        "lapped": bool((summary.get("evaluation") or {}).get("lap_completed")) if run.summary else None,
        **{key: _number(value) for key, value in values.items()},
    }


def _group(group: Group, figures: dict[str, GroupFigure]) -> dict[str, Any]:
    measured = {
        key: _named(figure.estimate) | {"runs": figure.runs, "never": figure.never} for key, figure in figures.items()
    }
    return {
        "group": group.label,
        "differs": group.differs,
        "seeds": group.seeds,
        "lapped": lapped(group),
        "figures": measured,
    }


def _comparison(comparison: Comparison) -> dict[str, Any]:
    return {
        "measure": comparison.measure.key,
        "better": comparison.first,
        "than": comparison.second,
        "runs": list(comparison.runs),
        "probability_of_improvement": _named(comparison.probability),
        "p": comparison.p,
        "corrected_p": comparison.corrected_p,
        "significant": comparison.significant,
    }


def _named(estimate: Estimate) -> dict[str, float | None]:
    return {name: _number(value) for name, value in asdict(estimate).items()}


def _estimate(estimate: Estimate) -> list[object]:
    return list(_named(estimate).values())


def _number(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def write_report(folder: Path, findings: Findings, best_lap: Rollout | None = None) -> None:
    """Writes the report into a folder, which is made if need be.

    Raises:
        CarrlError: it cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CarrlError(f"the folder '{folder}' cannot be made: {error.strerror}; choose another place") from error
    text = report_text(findings, best_lap, draw_figures(folder, findings))
    for name, content in (
        (REPORT, f"# Report\n\n{text}\n"),
        (DOCUMENT, as_json(findings, best_lap) + "\n"),
        (RUNS, runs_csv(findings)),
        (GROUPS, groups_csv(findings)),
    ):
        write_whole(folder / name, content.encode())


def draw_figures(folder: Path, findings: Findings) -> list[Picture]:
    """Draws what can be drawn of the findings into the folder, and tells what it has drawn."""
    # Here, as Matplotlib takes long to import and the document alone does not need it.
    from carrl.report.comparison_figures import draw_first_laps, draw_improvement, draw_smoothness
    from carrl.report.curve_figures import draw_profiles, draw_returns
    from carrl.report.trial_figures import draw_trials

    drawn = {
        TRIALS: draw_trials(folder / TRIALS.file, findings.groups),
        RETURNS: draw_returns(folder / RETURNS.file, findings.groups),
        PROFILES: draw_profiles(folder / PROFILES.file, findings.groups),
        IMPROVEMENT: draw_improvement(folder / IMPROVEMENT.file, findings),
        FIRST_LAPS: draw_first_laps(folder / FIRST_LAPS.file, findings),
        SMOOTHNESS: draw_smoothness(folder / SMOOTHNESS.file, findings),
    }
    return [picture for picture, is_there in drawn.items() if is_there]
