"""The page that describes the format says what the code does."""

import re
from pathlib import Path

import pytest

import carrl
from carrl.algorithms.dqn.dqn import dqn_columns
from carrl.data.description import log_schema
from carrl.log.messages import Episode, MetricsFields
from carrl.log.schema import (
    CHANNELS,
    EPISODES,
    FIRST_COLUMN_FIELD,
    FORMAT_VERSION,
    MESSAGE_NAMES,
    METRICS,
    small_message_class,
)

PAGE = (Path(__file__).parents[2] / "docs" / "log-format.md").read_text()
SCHEMA = log_schema(carrl.TrackEnv().task, dqn_columns(("forward", "left", "right")))
ROWS = [line.strip("| ").split(" | ") for line in PAGE.splitlines() if line.startswith("| ")]


def test_the_page_has_the_version():
    assert f"Format version {FORMAT_VERSION}." in PAGE


def test_the_page_lists_every_topic_with_its_channel_and_message():
    expected = [[str(CHANNELS[topic]), f"`{topic}`", f"`{name}`"] for topic, name in MESSAGE_NAMES.items()]
    assert [row[:3] for row in ROWS if len(row) == 4 and row[1].startswith("`/")] == expected


def test_the_page_lists_every_column_with_its_number_and_meaning():
    assert [(row[0], row[1], row[-1]) for row in ROWS if len(row) == 6 and row[0].isdecimal()] == [
        (str(number), f"`{column.name}`", column.meaning)
        for number, column in enumerate(SCHEMA.columns, start=FIRST_COLUMN_FIELD)
    ]


@pytest.mark.parametrize(("topic", "kind"), [(EPISODES, Episode), (METRICS, MetricsFields)])
def test_the_page_lists_every_field_of_the_small_messages(topic, kind):
    section = PAGE[PAGE.index(f"`{MESSAGE_NAMES[topic]}`, by field") :].split("\n\n")[1]
    numbers = {field.name: field.number for field in small_message_class(topic).DESCRIPTOR.fields}
    found = dict(re.findall(r"^\| (\d+) \| `(\w+)`", section, flags=re.MULTILINE))
    assert {name: int(number) for number, name in found.items()} == numbers
    assert list(found.values()) == ["run", *kind._fields]


def test_the_snippet_on_the_page_reads_a_log(log_path, monkeypatch, capsys):
    monkeypatch.chdir(log_path.parent)
    [snippet] = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
    exec(snippet, {})
    assert len(capsys.readouterr().out.splitlines()) == 3 + 2
