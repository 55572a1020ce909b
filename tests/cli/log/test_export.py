"""`carrl log export`: tables that hold the log's numbers, files that show an episode, refusals that leave no file."""

import csv
import dataclasses
import os
import sys

import numpy as np
import pytest

import carrl.log
from carrl.log.codec import tensordict_of
from carrl.log.writer import LogWriter
from tests.cli.log.conftest import SCENE, SCHEMA, columns_of, write_log

HEADINGS = [
    *(f"observation_{index}" for index in range(5)),
    "action",
    "reward",
    *("reward_collision", "reward_proximity", "reward_gate", "reward_steering"),
    *(f"next_observation_{index}" for index in range(5)),
    *("terminated", "truncated", "episode", "step", "car", "track"),
    *("state_x", "state_y", "state_heading", "next_state_x", "next_state_y", "next_state_heading"),
    *("next_gate", "gates_passed", "next_gates_passed", "time_ns"),
    *("action_value_forward", "action_value_left", "action_value_right"),
    *("epsilon", "exploratory"),
]


@pytest.fixture(scope="module")
def columns(log_path):
    return carrl.log.read_columns(log_path)


@pytest.fixture
def table(columns):
    """What the cells of a table should be: each column's values by its heading."""
    flat = {}
    headings = iter(HEADINGS)
    for column in SCHEMA.columns:
        values = columns[column.name].reshape(54, -1)
        flat |= {next(headings): values[:, index] for index in range(values.shape[1])}
    return flat


def test_csv_has_a_column_for_each_value_and_keeps_every_bit(run, log_path, tmp_path, table):
    path = tmp_path / "a.csv"
    assert run("export", log_path, path) == f"{path}: 54 transitions, {path.stat().st_size:,} bytes\n"
    with path.open(newline="") as file:
        headings, *rows = csv.reader(file)
    assert headings == HEADINGS
    for heading, cells in zip(headings, zip(*rows, strict=True), strict=True):
        if table[heading].dtype == bool:
            assert list(cells) == [str(value).lower() for value in table[heading].tolist()]
        else:
            read = np.array(cells, dtype=np.float64).astype(table[heading].dtype)
            np.testing.assert_array_equal(read, table[heading])


def test_csv_writes_a_number_as_short_as_its_type_allows(run, log_path, tmp_path):
    run("export", log_path, tmp_path / "a.csv", "--episode", "1")
    lines = (tmp_path / "a.csv").read_text().splitlines()
    assert lines[1].startswith("0.2,0.3,0.4,0.5,0.6,0,0.0,")
    assert lines[3].endswith(",nan,inf,-inf,0.1,false")


def test_parquet_holds_the_same_table_with_units_and_the_runs_metadata(run, log_path, tmp_path, table):
    parquet = pytest.importorskip("pyarrow.parquet")
    path = tmp_path / "a.parquet"
    assert run("export", log_path, path).startswith(f"{path}: 54 transitions, ")
    found = parquet.read_table(path)
    assert found.column_names == HEADINGS
    for heading in HEADINGS:
        values = found[heading].to_numpy()
        assert values.dtype == table[heading].dtype
        np.testing.assert_array_equal(values, table[heading])
    assert found.schema.field("state_heading").metadata[b"unit"] == b"rad"
    assert b"before the action" in found.schema.field("state_x").metadata[b"meaning"]
    assert (found.schema.metadata[b"seed"], found.schema.metadata[b"track"]) == (b"3", b"square")
    assert not any(key.startswith(b"column.") for key in found.schema.metadata)


def test_parquet_gathers_batches_into_groups(run, log_path, tmp_path, monkeypatch):
    parquet = pytest.importorskip("pyarrow.parquet")
    monkeypatch.setattr("carrl.export.tables.GROUP_ROWS", 20)
    run("export", log_path, tmp_path / "a.parquet")
    metadata = parquet.read_metadata(tmp_path / "a.parquet")
    assert [metadata.row_group(index).num_rows for index in range(metadata.num_row_groups)] == [21, 21, 12]


def test_npz_holds_the_columns_as_they_are_loaded_and_nothing_pickled(run, log_path, tmp_path, columns):
    run("export", log_path, tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz", allow_pickle=False) as found:
        assert found.files == [column.name for column in SCHEMA.columns]
        for name in found.files:
            assert found[name].dtype == columns[name].dtype
            np.testing.assert_array_equal(found[name], columns[name])


@pytest.mark.parametrize(
    ("flags", "count"),
    [
        (["--episode", "2"], 12),
        (["--episode", "2", "--episode", "7"], 16),
        (["--env", "0", "--env", "1"], 36),
        (["--begin", "0.4", "--end", "0.7"], 9),
    ],
)
@pytest.mark.parametrize("ending", ["csv", "npz"])
def test_a_table_has_the_transitions_asked_for(run, log_path, tmp_path, ending, flags, count):
    printed = run("export", log_path, tmp_path / f"a.{ending}", *flags)
    assert f": {count} transitions, " in printed


def test_names_that_do_not_fit_give_way_to_numbers(run, tmp_path):
    scene = dataclasses.replace(SCENE, reward_terms=("a", "a", "b", "c"))
    run("export", write_log(tmp_path / "train.mcap", scene=scene), tmp_path / "a.csv")
    heading = (tmp_path / "a.csv").read_text().splitlines()[0]
    assert ",reward,reward_0,reward_1,reward_2,reward_3," in heading


def test_a_log_that_describes_no_world_makes_a_table_all_the_same(run, tmp_path):
    with LogWriter(tmp_path / "bare.mcap", schema=SCHEMA, attachments={}, metadata={}) as writer:
        writer.write(tensordict_of(columns_of(0, 1), SCHEMA))
    run("export", tmp_path / "bare.mcap", tmp_path / "a.csv")
    assert ",action_value_forward,action_value_left,action_value_right," in (tmp_path / "a.csv").read_text()


def test_an_older_file_is_replaced_and_nothing_else_is_left(run, log_path, tmp_path):
    (tmp_path / "a.csv").write_text("old")
    run("export", log_path, tmp_path / "a.csv")
    assert (tmp_path / "a.csv").read_text().startswith("observation_0,")
    assert os.listdir(tmp_path) == ["a.csv"]


def test_an_episode_becomes_a_page_by_default_the_one_with_the_highest_return(run, log_path, tmp_path):
    path = tmp_path / "a.html"
    assert run("export", log_path, path).startswith(f"{path}: episode 2, 12 steps, ")
    assert path.read_text().startswith("<!doctype html>")
    assert run("export", log_path, path, "--episode", "7").startswith(f"{path}: episode 7, 4 steps, ")


@pytest.mark.parametrize(
    ("ending", "package", "begins"),
    [("gif", "av", b"GIF89a"), ("mp4", "av", b"\0\0\0"), ("rrd", "rerun", b"RRF"), ("mcap", "foxglove", b"\x89MCAP0")],
)
def test_an_episode_becomes_a_video_or_a_file_for_a_viewer(run, log_path, tmp_path, ending, package, begins):
    pytest.importorskip(package, reason=f"{ending} files need it; pip install 'carrl[export]'")
    path = tmp_path / f"a.{ending}"
    assert run("export", log_path, path, "--episode", "0").startswith(f"{path}: episode 0, 5 steps, ")
    assert path.read_bytes().startswith(begins)
    assert os.listdir(tmp_path) == [path.name]


@pytest.mark.parametrize(("ending", "package"), [("parquet", "pyarrow"), ("gif", "av"), ("mcap", "foxglove")])
def test_a_package_that_is_missing_is_named_with_its_remedy(refused, log_path, tmp_path, monkeypatch, ending, package):
    for name in ("carrl.export.foxglove", "carrl.export.rerun"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.setitem(sys.modules, package, None)
    assert "pip install 'carrl[export]'" in refused("export", log_path, tmp_path / f"a.{ending}")
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("name", ["a.xlsx", "a", "a.csv.gz"])
def test_an_unknown_ending_is_answered_with_those_there_are(refused, log_path, tmp_path, name):
    assert refused("export", log_path, tmp_path / name) == (
        f"'{tmp_path / name}' has no ending that names a format; choose one of: "
        ".csv, .parquet, .npz, .mp4, .gif, .html, .png, .pdf, .svg, .rrd, .mcap"
    )


def test_the_log_is_never_replaced_by_its_own_excerpt(refused, run, log_path, tmp_path):
    path = write_log(tmp_path / "train.mcap")
    link = tmp_path / "link.mcap"
    link.symlink_to(path)
    content = path.read_bytes()
    assert refused("export", path, path).endswith("is the log itself; choose another name")
    assert refused("export", path, link).endswith("is the log itself; choose another name")
    assert path.read_bytes() == content


@pytest.mark.parametrize(
    ("out", "flags", "says"),
    [
        ("a.csv", ["--episode", "99"], "has no such transition"),
        ("a.csv", ["--begin", "100"], "has no such transition"),
        ("a.csv", ["--begin", "2", "--end", "1"], "--end is 1 s; it must be later"),
        ("no/a.csv", [], "cannot be written: No such file or directory"),
        ("no/a.npz", [], "cannot be written: No such file or directory"),
        ("no/a.html", [], "cannot be written: No such file or directory"),
        ("a.html", ["--episode", "99"], "has no episode 99; those that ended are in 0..4"),
        ("a.html", ["--episode", "1", "--episode", "2"], "a .html file shows one whole episode"),
        ("a.gif", ["--env", "1"], "a .gif file shows one whole episode"),
    ],
)
def test_what_cannot_be_done_is_one_sentence_and_leaves_no_file(refused, log_path, tmp_path, out, flags, says):
    assert says in refused("export", log_path, tmp_path / out, *flags)
    assert os.listdir(tmp_path) == []


def test_a_folder_in_the_way_is_one_sentence(refused, log_path, tmp_path):
    (tmp_path / "a.csv").mkdir()
    assert "cannot be written: Is a directory" in refused("export", log_path, tmp_path / "a.csv")
    assert os.listdir(tmp_path) == ["a.csv"]


def test_an_export_that_fails_half_way_leaves_the_old_file(refused, log_path, tmp_path, monkeypatch):
    def fail(*_):
        raise OSError(28, "No space left on device")

    (tmp_path / "a.csv").write_text("old")
    monkeypatch.setattr("carrl.export.tables._texts", fail)
    assert "cannot be written: No space left on device" in refused("export", log_path, tmp_path / "a.csv")
    assert (tmp_path / "a.csv").read_text() == "old"
    assert os.listdir(tmp_path) == ["a.csv"]


@pytest.mark.parametrize("link", ["hardlink_to", "symlink_to", None])
@pytest.mark.parametrize(("ending", "verb"), [(".html", "replay"), (".png", "stats"), (".csv", "export")])
def test_no_verb_writes_over_the_log_that_it_reads(refused, log_path, tmp_path, ending, verb, link):
    log, out = tmp_path / f"a{ending}", tmp_path / f"b{ending}"
    log.write_bytes(log_path.read_bytes())
    if link:
        getattr(out, link)(log)
    out = out if link else log
    flags = {"replay": ["--no-open", "--output", out], "stats": ["--png", out], "export": [out]}[verb]
    assert "is the log itself; choose another name" in refused(verb, log, *flags)
    assert log.read_bytes() == log_path.read_bytes()


def test_the_default_page_of_a_replay_is_not_written_over_the_log(refused, log_path, tmp_path):
    log = tmp_path / "episode-2.html"
    log.write_bytes(log_path.read_bytes())
    assert "is the log itself" in refused("replay", log, "--no-open")
