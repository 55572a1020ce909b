"""Whatever a log may legally say, every verb shows it in the usual memory, or says in one sentence why it does not."""

import json
import math

import numpy as np
import pytest

from carrl.log.codec import tensordict_of
from carrl.log.writer import LogWriter
from tests.cli.log.conftest import METADATA, ROUNDS, SCENE, SCHEMA, TRACK, columns_of, ended_in

LARGEST = 3e38
"""About the largest number of single precision."""


@pytest.fixture
def extreme_log(tmp_path):
    """Writes the log of the other tests, with other values in some columns, episodes or metrics."""

    def write(columns=None, episode=None):
        path = tmp_path / "extreme.mcap"
        attachments = {"config.yaml": b"", "track.json": json.dumps(TRACK).encode()}
        with LogWriter(
            path, schema=SCHEMA, attachments=attachments, metadata={**METADATA, **SCENE.entries()}
        ) as writer:
            for index in range(ROUNDS):
                values = columns_of(index, 1)
                for name, value in (columns or {}).items():
                    values[name][...] = value(values[name]) if callable(value) else value
                writer.write(tensordict_of(values, SCHEMA))
                for ended in ended_in(index, 1):
                    writer.write_episode(ended._replace(**(episode or {})))
        return path

    return write


def every_second(value):
    """The column with this value in every second row of it."""

    def replaced(values):
        changed = values.copy()
        changed[1::2] = value
        return changed

    return replaced


COLUMNS = {
    "a pose a thousand kilometres off": {"state": every_second((1e6, 2e6, 0.0))},
    "a pose at the end of the numbers": {"state": every_second((LARGEST, -LARGEST, LARGEST))},
    "every pose off": {"state": LARGEST, "next_state": -LARGEST},
    "rewards": {"reward": LARGEST, "reward_terms": -LARGEST},
    "infinite rewards": {"reward": np.inf, "reward_terms": np.nan},
    "equal Q-values": {"action_value": LARGEST},
    "Q-values": {"action_value": (LARGEST, -LARGEST, 0.0)},
    "tiny Q-values": {"action_value": every_second(1e-45)},
    "readings": {"observation": LARGEST, "next_observation": -LARGEST},
    "epsilon": {"epsilon": np.nan},
    "steps": {"step": lambda steps: steps + 2**31 - 50},
    "cars": {"car": 2**31 - 1},
    "gates": {"next_gate": -(2**31), "gates_passed": 2**31 - 1, "next_gates_passed": 2**31 - 1},
}
EPISODES = {
    "returns": {"episode_return": 1e38},
    "returns near the end of the numbers": {"episode_return": -1e300},
    "a tiny return": {"episode_return": 5e-324},
    "lengths": {"length": 2**63 - 1},
    "negative lengths": {"length": -(2**63)},
    "laps": {"laps": 2**63 - 1, "gates": 2**63 - 1},
    "ends off the map": {"end_pose": (1e30, -1e30, 0.0)},
    "ends at the end of the numbers": {"end_pose": (1.7e308, -1.7e308, 1e308)},
    "times": {"begin_ns": -(2**63), "end_ns": 2**62},
    "cars": {"env": -(2**63), "frame": -1},
}


def assert_every_verb_copes(run, path, tmp_path):
    for verb in ("info", "ls", "show", "stats", "check"):
        assert run(verb, path)
        json.loads(run(verb, path, "--json"))
    for topic in ("/transitions", "/episodes", "/metrics"):
        run("cat", path, "--topic", topic, "--json")
        run("cat", path, "--topic", topic)
    run("stats", path, "--png", tmp_path / "stats.png")
    for ending in (".csv", ".npz", ".html"):
        run("export", path, tmp_path / f"out{ending}")


@pytest.mark.parametrize("case", COLUMNS)
def test_transitions_with_extreme_values_are_shown(run, extreme_log, tmp_path, case):
    assert_every_verb_copes(run, extreme_log(columns=COLUMNS[case]), tmp_path)


@pytest.mark.parametrize("case", EPISODES)
def test_episodes_with_extreme_values_are_shown(run, extreme_log, tmp_path, case):
    assert_every_verb_copes(run, extreme_log(episode=EPISODES[case]), tmp_path)


@pytest.mark.parametrize("ending", [".gif", ".rrd", ".mcap"])
@pytest.mark.parametrize("case", ["a pose at the end of the numbers", "infinite rewards", "readings"])
def test_extreme_values_do_not_stop_an_export(run, extreme_log, tmp_path, ending, case):
    pytest.importorskip({".gif": "PIL", ".rrd": "rerun", ".mcap": "foxglove"}[ending])
    assert "episode 2" in run("export", extreme_log(columns=COLUMNS[case]), tmp_path / f"out{ending}")


def test_poses_off_the_map_are_left_out_of_it_and_counted(run, extreme_log, log_path):
    def shift(poses):
        return np.where(np.arange(3)[:, None] == 2, poses + np.array((1e6, 0.0, 0.0)), poses)

    shown = run("show", extreme_log(columns={"state": shift, "next_state": shift}), "--episode", 2)
    assert "13 of 13 poses are off the map" in shown
    assert "off the map" not in run("show", log_path, "--episode", 2)


def test_crashes_off_the_map_are_counted_beside_those_on_it(run, extreme_log):
    path = extreme_log(episode={"end_pose": (1e30, 0.0, 0.0)})
    crashes = json.loads(run("stats", path, "--json"))["crashes"]
    assert (crashes["off_the_map"], sum(section["count"] for section in crashes["sections"])) == (3, 0)


@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan, 1e301])
def test_returns_that_cannot_be_summed_are_named(refused, run, extreme_log, value):
    path = extreme_log(episode={"episode_return": value})
    assert f"episode 0 has the return {value:g} and ended at" in refused("stats", path)
    assert run("ls", path)


def test_a_time_that_foxglove_cannot_tell_is_named(refused, extreme_log, tmp_path):
    pytest.importorskip("foxglove")
    path = extreme_log(columns={"time_ns": lambda times: times + 2**62})
    assert "a log for Foxglove can tell times from 0 to 4,294,967,296 s" in refused(
        "export", path, tmp_path / "out.mcap"
    )


def test_an_episode_off_the_attached_tracks_is_named(refused, extreme_log):
    path = extreme_log(episode={"track": 7})
    assert "episode 0 ended on track 7, which is not attached" in refused("stats", path)
