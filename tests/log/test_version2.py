"""A log of format version 2, written by the last version that made them: 800 transitions of 8 cars on the oval."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch

import carrl.log
from carrl.cli.main import main
from carrl.log import Log, read_trace
from carrl.log.version2 import LACKS

OLD = Path(__file__).parent / "version2.mcap"


@pytest.fixture(scope="module")
def columns():
    return carrl.log.read_columns(OLD)


def test_its_transitions_have_the_columns_of_version_3(columns):
    with Log(OLD) as log:
        assert log.version == 2
        assert list(columns) == [column.name for column in log.schema.columns]
        assert log.schema.by_name["action_value"].entries == ("forward", "left", "right")
        for column in log.schema.columns:
            assert columns[column.name].dtype == column.dtype
            assert columns[column.name].shape == (800, *column.shape)


def test_the_states_after_the_steps_are_those_that_the_next_steps_began_with(columns):
    followed = 0
    for car in range(8):
        rows = np.flatnonzero(columns["car"] == car)
        on = columns["episode"][rows[1:]] == columns["episode"][rows[:-1]]
        expected = columns["state"][rows[1:]][on]
        assert columns["next_state"][rows[:-1]][on] == pytest.approx(expected, abs=1e-4)
        followed += on.sum()
    assert followed > 700


def test_gates_are_counted_by_the_reward_and_which_one_is_next_is_unknown(columns):
    assert (columns["next_gate"] == -1).all()
    passes = columns["next_gates_passed"] - columns["gates_passed"]
    assert np.array_equal(passes, columns["reward_terms"][:, 2] > 0)
    for episode in carrl.log.read_episodes(OLD):
        assert columns["next_gates_passed"][columns["episode"] == episode.episode][-1] == episode.gates
    assert passes.sum() > 5


def test_gates_are_counted_alike_whether_an_episode_is_read_alone_or_all_are(columns):
    with Log(OLD) as log:
        for episode in np.unique(columns["episode"]).tolist():
            trace = read_trace(log, episode)
            assert np.array_equal(trace.gates_passed[:-1], columns["gates_passed"][columns["episode"] == episode])
            assert all(gate == -1 for _, gate in trace.passings)


def test_it_loads_in_todays_layout(columns):
    loaded = carrl.log.load(OLD)
    assert torch.equal(loaded["next", "pose"], torch.from_numpy(columns["next_state"]))
    assert torch.equal(loaded["car"], torch.from_numpy(columns["car"]))
    assert {"observation", "action", "action_value", "epsilon", "exploratory", "pose", "next_gate"} <= set(
        loaded.keys()
    )


@pytest.mark.parametrize("verb", [["info"], ["ls"], ["show"], ["stats"], ["cat", "--limit", "3"], ["check"]])
@pytest.mark.parametrize("flags", [[], ["--json"]])
def test_every_verb_reads_it(capsys, verb, flags):
    assert main(["log", verb[0], str(OLD), *verb[1:], *flags]) == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    if flags and verb[0] != "cat":
        json.loads(printed.out)


def test_info_says_what_it_lacks(capsys):
    main(["log", "info", str(OLD)])
    assert LACKS in capsys.readouterr().out
    main(["log", "info", str(OLD), "--json"])
    assert json.loads(capsys.readouterr().out)["lacks"] == LACKS


@pytest.mark.parametrize("ending", [".csv", ".parquet", ".npz", ".html", ".gif", ".rrd", ".mcap"])
def test_it_is_exported(tmp_path, ending):
    for package in {".parquet": ["pyarrow"], ".gif": ["PIL"], ".rrd": ["rerun"], ".mcap": ["foxglove"]}.get(ending, []):
        pytest.importorskip(package)
    assert main(["log", "export", str(OLD), str(tmp_path / f"out{ending}")]) == 0
    assert (tmp_path / f"out{ending}").stat().st_size > 1000


def test_it_is_replayed(tmp_path):
    assert main(["log", "replay", str(OLD), "--no-open", "--output", str(tmp_path / "out.html")]) == 0


@pytest.mark.parametrize("size", [None, 30_000])
def test_it_is_recovered_as_what_it_is(tmp_path, columns, size):
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(OLD.read_bytes()[:size])
    recovery = carrl.log.recover(damaged, tmp_path / "new.mcap")
    assert (recovery.transitions > 50, recovery.finished, recovery.complete) == (True, size is None, size is None)
    assert carrl.log.read_summary(tmp_path / "new.mcap").format_version == 2
    for name, values in carrl.log.read_columns(tmp_path / "new.mcap").items():
        np.testing.assert_array_equal(values, columns[name][: recovery.transitions])
    assert carrl.log.verify(tmp_path / "new.mcap").transitions == recovery.transitions


def test_its_transitions_alone_are_recovered_from_a_piece(tmp_path, columns):
    """A chunk of version 2 does not describe its columns, but there is only one way that they can be."""
    (tmp_path / "piece.mcap").write_bytes(OLD.read_bytes()[20_000:])
    recovery = carrl.log.recover(tmp_path / "piece.mcap", tmp_path / "new.mcap")
    assert recovery.metadata_lost
    assert recovery.transitions > 50
    assert carrl.log.verify(tmp_path / "new.mcap").transitions == recovery.transitions
