"""A report in words and tables, in Markdown."""

import csv
import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from carrl.config import check_targets
from carrl.errors import ConfigError, printable
from carrl.evaluation.results import DrivingStyle, Rollout, styles_of
from carrl.report.findings import SIGNIFICANCE, Comparison, Findings, GroupFigure, lapped, written_p
from carrl.report.measures import CONFIDENCE, RESAMPLES, Estimate, Measure, measures_of
from carrl.report.runs import RunResult, missing_lap
from carrl.task.task import World
from carrl.train.build import build_world

HEADER = (
    "run",
    "episodes",
    "frames",
    "first lap: episode",
    "first lap: frame",
    "best lap",
    "lap reward",
    "steps",
)
BEST_LAP_HEADER = ("forward / best", "switches / best")
"""What is added where the best possible lap is known: a run's figures as shares of its."""
METHOD = f"""\
- Runs of a group differ in their seed alone. Of a group stands the interquartile mean of its runs, with its
  {CONFIDENCE:.0%} interval: percentiles of a bootstrap, stratified by group, of {RESAMPLES:,} resamples.
- The probability of improvement is that of a run of the one group being better than a run of the other, ties counted
  half, with the same kind of interval.
- A difference is significant where this interval excludes 0.5 and the corrected p is below {SIGNIFICANCE}. p is that of
  the exact two-sided Mann-Whitney test, corrected by Holm's method for all pairs that are compared by the same measure,
  not for the number of measures.
- The first lap is a greedy evaluation that completes the lap, after at least one update, and is confirmed by the next
  evaluation, which completes it as well. A run without one has its first lap after all others' in comparisons. In means
  it counts with the frames or seconds that it was driven, and the mean is marked ≥.
- Progress, reward, smoothness, lap time and speed are those of the best greedy drive; the last three only of complete
  laps. Lap times are interpolated within the step, and the mean of several drives.
- Returns and rewards are compared only between groups with the same track and rewards, lap times only between those
  with the same track and number of starts.
- Seconds depend on the machine and on what else it did. Seeds that were trained at once share one clock and one
  compilation; their times are not compared."""


def markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown, its first column to the left and the others to the right."""
    lines = [[printable(cell).replace("|", "\\|") for cell in line] for line in [header, *rows]]
    lines.insert(1, ["---", *["---:"] * (len(header) - 1)])
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def comma_separated(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A table as CSV; None is an empty cell."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue()


def runs_table(runs: list[RunResult], best_lap: Rollout | None = None) -> str:
    """The runs as a table in Markdown, with their distance from the best possible lap if that is given."""
    styles = styles_of((run.summary or {}).get("evaluation") or {} for run in runs)
    header = [*HEADER, *(style.name for style in styles)]
    table = [_row(run, styles) for run in runs]
    if best_lap is not None:
        header += BEST_LAP_HEADER
        table = [row + _beside(run, best_lap) for row, run in zip(table, runs, strict=True)]
    return markdown(header, table)


def common_world(runs: list[RunResult], trust: Sequence[str] = ()) -> World:
    """The world that all the runs were trained in, which may have parts of the trusted modules.

    Raises:
        ConfigError: it is not one and the same, or no run has a configuration that can be read.
        CarrlError: it cannot be built.
    """
    runs = [run for run in runs if run.config]
    if not runs:
        raise ConfigError("no run has a configuration that can be read; the best possible lap depends on it")
    for run in runs:
        check_targets(run.config, trust)
    worlds = [build_world(run.config) for run in runs]
    differing = next((run.label for run, world in zip(runs, worlds, strict=True) if not _alike(world, worlds[0])), None)
    if differing is not None:
        raise ConfigError(f"'{runs[0].label}' and '{differing}' were not trained with the same track, car and sensors")
    return worlds[0]


def _alike(world: World, other: World) -> bool:
    """Whether the same laps are possible without a step near a wall."""
    distances = [each.sensor.max_range * each.reward.near_wall.threshold for each in (world, other)]
    tracks = [[track.as_dict() for track in each.circuits.training] for each in (world, other)]
    same = tracks[0] == tracks[1] and (world.vehicle, world.action) == (other.vehicle, other.action)
    fans = [(each.sensor.rays, each.sensor.field_of_view, each.sensor.turn) for each in (world, other)]
    return same and fans[0] == fans[1] and math.isclose(*distances, rel_tol=1e-4)


def _row(run: RunResult, styles: Sequence[DrivingStyle]) -> list[str]:
    """The run's figures under `HEADER`, and how it drives."""
    width = len(HEADER) + len(styles)
    if run.summary is None:
        return [run.label, str(len(run.ends.returns)), *[run.state] * 2, *["-"] * (width - 4)]
    first = run.summary["first_lap"]
    row = [
        run.label,
        f"{run.summary['episodes']:,}",
        f"{run.summary['frames']:,}",
        *([f"{first['episode']:,}", f"{first['frame']:,}"] if first else [missing_lap(run.summary, "never")] * 2),
    ]
    best = run.summary["evaluation"]
    if best is None:
        return [*row, *["-"] * (width - len(row))]
    return [
        *row,
        "complete" if best["lap_completed"] else f"{best['progress']:.0%}",
        f"{best['lap_reward']:.0f}",
        f"{best['lap_steps']}",
        *(style.written(best) for style in styles),
    ]


def _beside(run: RunResult, best_lap: Rollout) -> list[str]:
    """The run's figures under `BEST_LAP_HEADER`."""
    own = (run.summary or {}).get("evaluation")
    if own is None or "forward_share" not in own:
        return ["-"] * len(BEST_LAP_HEADER)
    return [
        f"{own[name] / getattr(best_lap, name):.2f}" if getattr(best_lap, name) else "-"
        for name in ("forward_share", "switches_per_100m")
    ]


@dataclass(frozen=True)
class Picture:
    """A figure of a report.

    Attributes:
        file: its name, beside the report.
        caption: what it shows.
    """

    file: str
    caption: str


def report_text(findings: Findings, best_lap: Rollout | None = None, pictures: Sequence[Picture] = ()) -> str:
    """The report: problems and significant differences first, then groups, pictures, comparisons and runs.

    Args:
        findings: what it tells.
        best_lap: the best possible lap, to tell how far each run is from it.
        pictures: that stand beside it.
    """
    parts = [*_problems(findings), *_differences(findings), *_groups(findings), *_pictures(pictures)]
    parts += _comparisons(findings)
    if parts:
        parts.append("## Runs")
    parts.append(runs_table(findings.runs, best_lap))
    if best_lap is not None:
        parts.append(best_lap_sentence(best_lap))
    if findings.comparisons or pictures:
        parts += ["## Method", METHOD]
    return "\n\n".join(parts)


def best_lap_sentence(best_lap: Rollout) -> str:
    """The best possible lap in words."""
    return (
        f"The best possible lap: {best_lap.lap_steps} steps, forward {best_lap.forward_share:.1%}, "
        f"{best_lap.switches_per_100m:.2f} switches / 100 m, {best_lap.reversals} reversals."
    )


def written_figure(figure: GroupFigure | None, measure: Measure) -> str:
    """An interquartile mean with its interval: "≥ 1,504 [752, 6,000]"."""
    if figure is None:
        return "-"
    estimate, at_least = figure.estimate, "≥ " if figure.never else ""
    if figure.runs == 1:
        return f"{at_least}{measure.write(estimate.value)}"
    return f"{at_least}{measure.write(estimate.value)} [{measure.write(estimate.low)}, {measure.write(estimate.high)}]"


def _problems(findings: Findings) -> Iterator[str]:
    if findings.problems:
        yield "## Problems"
        yield "\n".join(f"- **{each.kind}** {printable(f'{each.what}: {each.reason}')}" for each in findings.problems)


def _differences(findings: Findings) -> Iterator[str]:
    if len(findings.groups) < 2:
        return
    yield "## Significant differences"
    significant = findings.significant
    if significant:
        yield "\n".join(f"- significant: {printable(str(comparison))}" for comparison in significant)
    elif findings.runs_needed is not None:
        yield (
            "No difference is significant, and with so few runs none can be; "
            f"train at least {findings.runs_needed} seeds of each group."
        )
    else:
        yield "No difference is significant."


def _groups(findings: Findings) -> Iterator[str]:
    if len(findings.runs) < 2 or not findings.groups:
        return
    yield "## Groups"
    measures = measures_of(findings.runs)
    header = ["group", "runs", "lapped", *(measure.name for measure in measures)]
    rows = []
    for group, figures in zip(findings.groups, findings.figures, strict=True):
        counted, written = len(group.counted), [written_figure(figures.get(each.key), each) for each in measures]
        rows.append([group.label, str(counted), f"{lapped(group)} of {counted}", *written])
    yield markdown(header, rows)


def _pictures(pictures: Sequence[Picture]) -> Iterator[str]:
    if pictures:
        yield "## Figures"
    for picture in pictures:
        yield f"![{picture.caption}]({picture.file})"
        yield f"*{picture.caption}*"


def _comparisons(findings: Findings) -> Iterator[str]:
    if findings.comparisons:
        yield "## Comparisons"
        header = [
            "measure",
            "group",
            "against",
            "runs",
            "probability of improvement",
            "p",
            "corrected p",
            "significant",
        ]
        yield markdown(header, [_comparison_row(comparison) for comparison in findings.comparisons])


def _comparison_row(comparison: Comparison) -> list[str]:
    return [
        comparison.measure.name,
        comparison.first,
        comparison.second,
        " and ".join(map(str, comparison.runs)),
        _written_chance(comparison.probability),
        written_p(comparison.p),
        written_p(comparison.corrected_p),
        "yes" if comparison.significant else "no",
    ]


def _written_chance(chance: Estimate) -> str:
    return f"{chance.value:.2f} [{chance.low:.2f}, {chance.high:.2f}]"
