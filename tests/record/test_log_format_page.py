"""The page that describes the format says what the code does."""

import re
from pathlib import Path

from carrl.record.schema import COLUMNS

PAGE = (Path(__file__).parents[2] / "docs" / "log-format.md").read_text()


def test_the_page_lists_every_column_with_its_number_and_meaning():
    rows = [line.strip("| ").split(" | ") for line in PAGE.splitlines() if re.match(r"\| \d+ \| `", line)]
    assert [(row[0], row[1], row[-1]) for row in rows] == [
        (str(number), f"`{column.name}`", column.meaning) for number, column in enumerate(COLUMNS, start=2)
    ]


def test_the_snippet_on_the_page_reads_a_log(log_path, monkeypatch, capsys):
    monkeypatch.chdir(log_path.parent)
    [snippet] = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
    exec(snippet, {})
    assert len(capsys.readouterr().out.splitlines()) == 3
