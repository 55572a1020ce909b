"""Tables on the terminal fit it, whatever stands in them, and no figure is cut."""

import pytest

from carrl.cli.text.next_steps import print_next
from carrl.cli.text.terminal_table import MOST_WIDE, print_table

SENTENCE = "passed: 0.0767 % (limit 0.5 %); point mass 11.234 s, forward and backward along its line 11.242 s"
FIGURES = ["laps", "95 % of laps", "progress", "collisions / km", "95 % of these", "lap reward", "steps", "lap, s"]
VALUES = ["8/8", "68-100%", "100.0±0.0%", "0.000", "0.000-1.736", "1,950", "212", "21.23"]


def printed(capsys, *table, **options):
    print_table("a table", *table, **options)
    return capsys.readouterr().out.splitlines()[1:]


def cells(line):
    return [cell.strip() for cell in line.strip("│┃").replace("┃", "│").split("│")]


@pytest.mark.parametrize(("columns", "most"), [(60, 60), (80, 80), (200, MOST_WIDE)])
def test_text_is_folded_to_the_terminal_and_never_grows_beyond_reading(columns, most, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", str(columns))
    lines = printed(capsys, ("", ""), [("check: another method", SENTENCE)], figures=())
    assert max(map(len, lines)) <= most
    told = " ".join(cells(line)[1] for line in lines[1:-1])
    assert told.split() == SENTENCE.split()


@pytest.mark.parametrize("columns", [40, 80, 200])
def test_columns_of_figures_without_room_follow_below_beside_the_first_one(columns, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", str(columns))
    lines = printed(capsys, ("track", *FIGURES), [("oval", *VALUES)])
    assert max(map(len, lines)) <= columns
    rows = [cells(line) for line in lines if "oval" in line]
    assert len(rows) == {40: 3, 80: 2, 200: 1}[columns]
    assert [value for row in rows for value in row[1:]] == VALUES


def test_a_table_that_goes_into_a_file_is_folded_nowhere(monkeypatch, capsys):
    monkeypatch.delenv("COLUMNS", raising=False)
    lines = printed(capsys, ("", ""), [("check: another method", SENTENCE)], figures=())
    assert cells(lines[1]) == ["check: another method", SENTENCE]


def test_a_table_without_rows_is_its_heading(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    assert cells(printed(capsys, ("track", "laps"), [])[1]) == ["track", "laps"]


def test_a_next_command_stands_alone_on_one_line(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "40")
    command = f"evaluate {'folder/' * 20} --track oval"
    print_next((command, "drive it on another track"))
    head, what, line = capsys.readouterr().out.splitlines()
    assert (head, what.strip()) == ("next:", "# drive it on another track")
    assert line.startswith("  ") and line.endswith(f"carrl {command}")
