"""Markdown such as reports have, for those who read it on a terminal: its tables are drawn."""

import re
from itertools import groupby

from carrl.cli.text.terminal_table import TextConsole, print_table

_BORDER = re.compile(r"(?<!\\)\|")


def print_markdown(text: str) -> None:
    """Prints it with tables that fit a terminal, under the headings above them; as it is where that is none."""
    console = TextConsole()
    if not console.is_terminal:
        print(text)
        return
    title = ""
    for is_table, block in groupby(text.splitlines(), key=lambda line: line.startswith("| ")):
        lines = list(block)
        if is_table:
            header, _, *rows = (
                [cell.strip().replace("\\|", "|") for cell in _BORDER.split(each)[1:-1]] for each in lines
            )
            print_table(title, header, rows)
            title = ""
            continue
        written = [line for line in lines if line or not title]
        if written and written[-1] == "":
            written.pop()
        if written and written[-1].startswith("#"):
            title = written.pop().lstrip("# ")
        for line in written:
            print(line.lstrip("# ") if line.startswith("#") else line)
