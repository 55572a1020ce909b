"""A report in words: Markdown for a terminal and for a file."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from carrl.evaluation.results import Drive
from carrl.printable import printable
from carrl.report.comparison import SIGNIFICANCE, Comparison, written_p
from carrl.report.findings import Findings, GroupFigure, lapped
from carrl.report.measures import MEASURES, Measure
from carrl.report.runs_table import runs_table
from carrl.report.statistics import CONFIDENCE, RESAMPLES, Estimate
from carrl.report.tables import markdown

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
- Progress, reward and smoothness are those of the best greedy drive; smoothness only where it completed the lap.
- Returns and rewards are compared only between groups with the same track and rewards.
- Seconds depend on the machine and on what else it did. Seeds that were trained at once share one clock and one
  compilation; their times are not compared."""


@dataclass(frozen=True)
class Picture:
    """A figure of a report.

    Attributes:
        file: its name, beside the report.
        caption: what it shows.
    """

    file: str
    caption: str


def report_text(findings: Findings, best_lap: Drive | None = None, pictures: Sequence[Picture] = ()) -> str:
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


def best_lap_sentence(best_lap: Drive) -> str:
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
    header = ["group", "runs", "lapped", *(measure.name for measure in MEASURES)]
    rows = []
    for group, figures in zip(findings.groups, findings.figures, strict=True):
        counted, written = len(group.counted), [written_figure(figures.get(each.key), each) for each in MEASURES]
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
