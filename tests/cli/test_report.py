"""`carrl report` as typed."""

import csv
import json

import pytest

from carrl.cli.main import main
from tests.run_folders import write_offline_run, write_run, write_sweep

FIGURES = {
    "evaluation_curves.png",
    "learning_curves.png",
    "performance_profile.png",
    "improvement.png",
    "first_lap.png",
    "smoothness.png",
}
TEXTS = {"report.md", "report.json", "runs.csv", "groups.csv"}


@pytest.fixture
def sweep(tmp_path):
    """Five seeds each of a loss that laps late and of one that laps early."""
    laps = {"dqn": [500, 600, 700, 800, None], "double_dqn": [100, 150, 200, 250, 300]}
    return write_sweep(tmp_path / "sweep", laps)


def test_a_report_leaves_text_tables_and_figures_in_one_folder(sweep, tmp_path, capsys):
    out = tmp_path / "new" / "report"
    assert main(["report", str(sweep), "--out", str(out)]) == 0
    assert {path.name for path in out.iterdir()} == FIGURES | TEXTS
    text = (out / "report.md").read_text()
    for figure in FIGURES:
        assert (out / figure).read_bytes().startswith(b"\x89PNG")
        assert f"]({figure})" in text
    with (out / "runs.csv").open() as file:
        assert [row["seed"] for row in csv.DictReader(file)] == ["0", "1", "2", "3", "4"] * 2
    assert capsys.readouterr().out.endswith(f"report in {out}\n")


def test_the_same_runs_give_the_same_bytes(sweep, tmp_path):
    for name in ("one", "two"):
        assert main(["report", str(sweep), "--out", str(tmp_path / name)]) == 0
    for name in FIGURES | TEXTS:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes(), name


def test_problems_and_significant_differences_come_first(sweep, capsys):
    (sweep / "loss=dqn" / "seed=3" / "summary.json").write_text("")
    assert main(["report", str(sweep)]) == 0
    headings = [line for line in capsys.readouterr().out.splitlines() if line.startswith("## ")]
    assert headings == [
        "## Problems",
        "## Significant differences",
        "## Groups",
        "## Comparisons",
        "## Runs",
        "## Method",
    ]


def test_json_is_one_document_and_nothing_else(sweep, tmp_path, capsys):
    assert main(["report", str(sweep), "--json", "--out", str(tmp_path / "out")]) == 0
    output = capsys.readouterr().out
    document = json.loads(output)
    assert [group["group"] for group in document["groups"]] == ["loss=dqn", "loss=double_dqn"]
    assert [group["seeds"] for group in document["groups"]] == [[0, 1, 2, 3, 4]] * 2
    assert document["problems"] == []
    assert any("laps after fewer frames" in sentence for sentence in document["significant"])
    assert output == (tmp_path / "out" / "report.json").read_text()


def test_a_single_run_is_a_single_row(tmp_path, capsys):
    write_run(tmp_path / "a")
    assert main(["report", str(tmp_path)]) == 0
    header, _, row = capsys.readouterr().out.splitlines()
    assert header.startswith("| run | episodes |")
    assert row.startswith("| a | 2 | 1,000 | 1 | 500 | complete |")


def test_seeds_of_one_configuration_are_summed_up_without_comparisons(tmp_path, capsys):
    for seed, lap in enumerate((100, 200, 300, 400)):
        write_run(tmp_path / f"seed={seed}", seed, lap)
    assert main(["report", str(tmp_path), "--out", str(tmp_path / "out")]) == 0
    output = capsys.readouterr().out
    assert "| all runs | 4 | 4 of 4 | 250 [" in output
    assert "Comparisons" not in output
    assert not (tmp_path / "out" / "improvement.png").exists()


def test_runs_that_learnt_from_logs_have_no_learning_curve_and_the_rest(tmp_path):
    for seed in (0, 1):
        write_offline_run(tmp_path / str(seed), seed)
    assert main(["report", str(tmp_path), "--out", str(tmp_path / "out")]) == 0
    assert {path.name for path in (tmp_path / "out").iterdir()} == TEXTS | {"performance_profile.png", "smoothness.png"}


def test_damaged_runs_alone_are_reported(tmp_path, capsys):
    write_run(tmp_path / "a")
    (tmp_path / "a" / "summary.json").write_text("")
    assert main(["report", str(tmp_path), "--out", str(tmp_path / "out")]) == 0
    assert "- **damaged** a: summary.json is damaged" in capsys.readouterr().out
    assert {path.name for path in (tmp_path / "out").iterdir()} == TEXTS


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--baseline", "loss=cql"], "no group is 'loss=cql'; choose a baseline of: loss=dqn; loss=double_dqn"),
        (["--out", "{file}/out"], "cannot be made"),
    ],
)
def test_bad_input_is_one_sentence_and_exit_code_2(arguments, message, sweep, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    arguments = [argument.format(file=tmp_path / "file") for argument in arguments]
    assert main(["report", str(sweep), *arguments]) == 2
    output = capsys.readouterr()
    assert message in output.err
    assert output.err.count("\n") == 1
    assert output.out == ""


@pytest.mark.parametrize(
    ("ending", "begins"), [("png", b"\x89PNG"), ("pdf", b"%PDF"), ("svg", b"<?xml"), ("PDF", b"%PDF")]
)
def test_curves_are_drawn_in_the_format_that_the_name_asks_for(sweep, tmp_path, ending, begins):
    path = tmp_path / f"curves.{ending}"
    assert main(["report", str(sweep), "--curves", str(path)]) == 0
    assert path.read_bytes().startswith(begins)


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        (["--curves", "c.jpg"], "--curves is 'c.jpg'; its name must end in .png, .pdf or .svg"),
        (["--curves", "c"], "--curves is 'c'; its name must end in .png, .pdf or .svg"),
        (["--bin-size", "0.5"], "--bin-size has no effect without --best-lap; add that, or leave it out"),
        (["--bin-size", "x"], "argument --bin-size: invalid float value: 'x'; carrl report --help tells more"),
        (["--jsn"], "unrecognized arguments: --jsn; did you mean --json? carrl report --help tells more"),
    ],
)
def test_a_flag_that_cannot_be_done_is_one_sentence_and_exit_code_2(sweep, tmp_path, flags, says, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["report", str(sweep), *flags]) == 2
    output = capsys.readouterr()
    assert (output.out, output.err) == ("", f"carrl: {says}\n")
    assert not list(tmp_path.glob("c*"))
