"""`carrl log show`: which episode, which steps, as text and as JSON."""

import json
import re

import pytest

from carrl.cli.main import main
from carrl.log.writer import LogWriter
from tests.cli.log.conftest import SCENE, write_log
from tests.logs import make_schema


@pytest.fixture
def document(run, log_path):
    """The JSON document of some flags."""
    return lambda *flags: json.loads(run("show", log_path, "--json", *flags))


def test_by_default_it_prints_the_episode_with_the_highest_return(run, log_path):
    printed = run("show", log_path)
    for words in ("episode 2", "square", "12 steps", "return 200", "4 gates", "time limit", "forward", "action value"):
        assert words in printed


def test_the_steps_asked_for_are_in_the_table(run, log_path):
    def steps(*flags):
        lines = run("show", log_path, "--episode", "2", *flags).splitlines()
        return [int(match[1]) for line in lines if (match := re.match(r" +(\d+) .*(forward|left|right)\*? ", line))]

    assert steps("--all") == list(range(12))
    assert steps("--steps", "3:6") == [3, 4, 5]
    assert steps("--steps", "10:") == [10, 11]
    assert steps("--steps", ":2") == [0, 1]


def test_a_table_in_a_pipe_is_wide_enough_for_every_column(run, log_path, monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)
    assert "…" not in run("show", log_path)


def test_as_json_it_has_the_episode_and_all_of_its_transitions(document):
    found = document("--episode", "1")
    assert (found["episode"], found["car"], found["track_name"], found["first_step"]) == (1, 1, "square", 0)
    assert (found["length"], found["episode_return"], found["gates"], found["ended"]) == (7, -150.0, 1, "collision")
    assert found["action_names"] == ["forward", "left", "right"]
    assert [row["step"] for row in found["transitions"]] == list(range(7))
    assert found["transitions"][2]["action_value"] == [None, None, None]


def test_as_json_it_has_the_steps_asked_for(document):
    assert [row["step"] for row in document("--steps", "1:3")["transitions"]] == [1, 2]
    assert document("--steps", "1:3")["length"] == 12


def test_an_unfinished_episode_can_be_shown_by_its_number(document):
    assert (document("--episode", "7")["ended"], document("--episode", "7")["length"]) == ("unfinished", 4)


def test_the_default_is_the_best_of_those_that_were_recorded(run, tmp_path):
    path = write_log(tmp_path / "train.mcap", envs=2)
    assert json.loads(run("show", path, "--json"))["episode"] == 3


def test_an_episode_whose_transitions_were_left_out_is_told_apart_from_one_that_never_was(refused, tmp_path):
    path = write_log(tmp_path / "train.mcap", every_nth_episode=2)
    assert "notes the end of episode 3 but has no transition of it" in refused("show", path, "--episode", "3")
    assert "recorder.every_nth_episode" in refused("show", path, "--episode", "3")
    assert "has no episode 9; those that ended are in 0..4" in refused("show", path, "--episode", "9")


def test_a_log_without_ended_episodes_names_one_that_can_be_shown(refused, tmp_path, monkeypatch):
    monkeypatch.setattr("tests.cli.log.conftest.ended_in", lambda *_: [])
    path = write_log(tmp_path / "train.mcap")
    assert "such as --episode 0" in refused("show", path)
    assert "nor did any episode end in it" in refused("show", path, "--episode", "9")


def test_a_log_without_transitions_has_nothing_to_show(refused, tmp_path):
    LogWriter(tmp_path / "empty.mcap", schema=make_schema(), attachments={}, metadata={}).close()
    assert "holds no transitions" in refused("show", tmp_path / "empty.mcap")


def test_a_log_that_describes_no_world_is_refused(refused, tmp_path, monkeypatch):
    monkeypatch.setattr(type(SCENE), "entries", lambda scene: {})
    assert "cannot be drawn: its metadata has no entry 'action_names'" in refused(
        "show", write_log(tmp_path / "train.mcap")
    )


def test_steps_that_the_episode_does_not_have_are_refused(refused, log_path):
    says = "--steps asks for none of the steps of episode 2, 0..11"
    assert refused("show", log_path, "--steps", "50:60") == says
    assert refused("show", log_path, "--steps", "6:6") == says


@pytest.mark.parametrize("span", ["5", "a:b", "-3:", "5:6:7"])
def test_a_span_that_is_none_is_refused(capsys, log_path, span):
    assert main(["log", "show", str(log_path), f"--steps={span}"]) == 2
    assert "is no span of steps; write it as 20:40, 20: or :40" in capsys.readouterr().err
