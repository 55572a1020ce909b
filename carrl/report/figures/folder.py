"""The folder of a report: text, tables, document and figures side by side."""

from pathlib import Path

from carrl.errors import CarrlError
from carrl.evaluation.results import Drive
from carrl.files import write_whole
from carrl.report.document import as_json, groups_csv, runs_csv
from carrl.report.figures.improvement import draw_improvement
from carrl.report.figures.learning import draw_profiles, draw_returns
from carrl.report.figures.strips import draw_first_laps, draw_smoothness
from carrl.report.findings import Findings
from carrl.report.text import Picture, report_text

REPORT, DOCUMENT, RUNS, GROUPS = "report.md", "report.json", "runs.csv", "groups.csv"
RETURNS = Picture("learning_curves.png", "Return against frames: interquartile mean of the runs, with its 95 % band")
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


def write_report(folder: Path, findings: Findings, best_lap: Drive | None = None) -> None:
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
    drawn = {
        RETURNS: draw_returns(folder / RETURNS.file, findings.groups),
        PROFILES: draw_profiles(folder / PROFILES.file, findings.groups),
        IMPROVEMENT: draw_improvement(folder / IMPROVEMENT.file, findings),
        FIRST_LAPS: draw_first_laps(folder / FIRST_LAPS.file, findings),
        SMOOTHNESS: draw_smoothness(folder / SMOOTHNESS.file, findings),
    }
    return [picture for picture, is_there in drawn.items() if is_there]
