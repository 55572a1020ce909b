"""Reports on a terminal: tables that are drawn; elsewhere the Markdown as it is."""

import re

import pytest

from carrl.cli.text import markdown_terminal
from carrl.cli.text.markdown_terminal import print_markdown

TEXT = """\
- two runs differ

## Runs

| run | best lap |
| --- | ---: |
| seed=0 | complete |
| a\\|b | 12% of a lap |

Some words.

## Method

- The first word."""


@pytest.fixture
def terminal(monkeypatch):
    console = markdown_terminal.TextConsole
    monkeypatch.setattr(console, "is_terminal", property(lambda _: True))
    monkeypatch.setenv("COLUMNS", "80")


def test_in_a_pipe_it_is_markdown(capsys):
    print_markdown(TEXT)
    assert capsys.readouterr().out == TEXT + "\n"


@pytest.mark.usefixtures("terminal")
def test_on_a_terminal_headings_stand_above_drawn_tables_and_no_word_is_lost(capsys):
    print_markdown(TEXT)
    lines = [re.sub(r"\x1b\[[0-9;]*m", "", line).strip() for line in capsys.readouterr().out.splitlines()]
    assert lines[0] == "- two runs differ"
    assert [lines[index + 1][0] for index, line in enumerate(lines) if line == "Runs"] == ["┏"]
    rows = [[cell.strip() for cell in line.strip("│").split("│")] for line in lines if line.startswith("│")]
    assert rows == [["seed=0", "complete"], ["a|b", "12% of a lap"]]
    assert [line for line in lines[-5:] if line] == ["Some words.", "Method", "- The first word."]
