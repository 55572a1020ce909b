"""Whatever is written comes back: tracks as CSV, transitions as logs, plain values as YAML."""

import tempfile
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from carrl.errors import TrackError
from carrl.log import read_columns, read_episodes, read_metrics
from carrl.log.codec import tensordict_of
from carrl.log.messages import Episode, Metrics
from carrl.log.writer import LogWriter
from carrl.plain_yaml import parse_yaml
from carrl.tracks.centreline import Centreline
from carrl.tracks.csv_file import read_csv, write_csv
from tests.logs import make_schema

exactly = settings(max_examples=25, deadline=None, derandomize=True)


@pytest.fixture(scope="module")
def folder():
    with tempfile.TemporaryDirectory() as name:
        yield Path(name)


coordinates = st.floats(-1e5, 1e5).map(lambda x: round(x, 3))
widths = st.floats(0.001, 1e5)


@exactly
@given(st.lists(st.tuples(coordinates, coordinates, widths, widths), min_size=3, max_size=40))
def test_a_centreline_that_is_written_is_read_back_to_a_micrometre_or_refused_for_points_too_close(folder, rows):
    table = np.array(rows)
    written = Centreline(table[:, :2], width_right=table[:, 2], width_left=table[:, 3])
    write_csv(folder / "a.csv", written)
    steps = np.linalg.norm(np.roll(table[:, :2], -1, axis=0) - table[:, :2], axis=1)
    if steps.min() < 0.011:
        try:
            read_csv(folder / "a.csv")
        except TrackError:
            return
    found = read_csv(folder / "a.csv")
    kept = _apart(table[:, :2])
    for name in ("points", "width_right", "width_left"):
        np.testing.assert_allclose(getattr(found, name), getattr(written, name)[kept], atol=1e-6, rtol=0)


def _apart(points):
    """Indices of the points that are not within 1 cm of the one kept before, nor at the end of the first."""
    kept = [0]
    for index in range(1, len(points)):
        if np.linalg.norm(points[index] - points[kept[-1]]) >= 0.01:
            kept.append(index)
    while len(kept) > 1 and np.linalg.norm(points[kept[-1]] - points[0]) < 0.01:
        kept.pop()
    return kept


def _values(column, count):
    shape = (count, *column.shape)
    if column.dtype == "bool":
        return arrays.arrays(np.bool_, shape)
    if column.dtype == "float32":
        return arrays.arrays(np.float32, shape, elements=st.floats(width=32))
    limits = np.iinfo(column.wire)
    return arrays.arrays(np.int64, shape, elements=st.integers(int(limits.min), int(limits.max)))


@st.composite
def batches(draw):
    schema = make_schema(draw(st.integers(1, 9)))
    drawn = []
    for count in draw(st.lists(st.integers(1, 5), min_size=1, max_size=4)):
        drawn.append({column.name: draw(_values(column, count)) for column in schema.columns})
    times = sorted(draw(st.lists(st.integers(0, 2**63 - 1), min_size=20, max_size=20)))
    for columns in drawn:
        columns["time_ns"], times = np.array(times[: len(columns["action"])]), times[len(columns["action"]) :]
    return schema, drawn


@settings(exactly, max_examples=15)
@given(batches())
def test_transitions_of_any_values_come_back_bit_for_bit(folder, drawn):
    schema, drawn = drawn
    with LogWriter(folder / "a.mcap", schema=schema, attachments={}, metadata={}) as writer:
        for columns in drawn:
            writer.write(tensordict_of(columns, schema))
    found = read_columns(folder / "a.mcap")
    for column in schema.columns:
        written = np.concatenate([columns[column.name] for columns in drawn])
        assert found[column.name].dtype == written.dtype
        assert found[column.name].tobytes() == written.tobytes(), column.name


whole, number = st.integers(-(2**63), 2**63 - 1), st.floats(allow_nan=False)
time_ns = st.integers(0, 2**63 - 1)
episodes = st.builds(
    Episode,
    *[whole] * 4,
    *[time_ns] * 2,
    number,
    *[whole] * 3,
    st.sampled_from(["collision", "time limit"]),
    st.tuples(number, number, number),
)


FIGURES = st.dictionaries(st.sampled_from(("td_error", "action_value", "epsilon", "alpha")), number, min_size=1)
"""DQN's, in its order or not, and others."""


@exactly
@given(st.lists(episodes, max_size=4), st.lists(st.builds(Metrics, whole, whole, number, number, FIGURES), max_size=4))
def test_episodes_and_metrics_of_any_values_come_back(folder, ended, told):
    with LogWriter(folder / "a.mcap", schema=make_schema(), attachments={}, metadata={}) as writer:
        for episode in sorted(ended, key=lambda each: each.end_ns):
            writer.write_episode(episode)
        for metrics in told:
            writer.write_metrics(metrics)
    assert read_episodes(folder / "a.mcap") == sorted(ended, key=lambda each: each.end_ns)
    assert read_metrics(folder / "a.mcap") == told


plain = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**18), 10**18) | st.floats(allow_nan=False) | st.text(max_size=30),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=9), inner, max_size=4),
    max_leaves=12,
)


@exactly
@given(plain)
def test_plain_values_come_back_from_yaml(values):
    assert parse_yaml(yaml.safe_dump(values, allow_unicode=False).encode()) == values


@exactly
@given(st.binary(max_size=200) | st.text(max_size=100).map(str.encode))
def test_any_bytes_are_yaml_or_refused_in_a_line(content):
    try:
        parse_yaml(content)
    except ValueError as error:
        assert "\n" not in str(error)
