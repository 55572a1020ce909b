"""Logs as what there is to learn from."""

import json

import pytest
import torch

from carrl.data.logs import check_logs, fill_from_logs
from carrl.data.replay_buffer import KEYS, make_replay_buffer
from carrl.errors import LogError
from carrl.log import load
from carrl.sim.sensor import Sensor
from carrl.task.action import DiscreteActions
from carrl.task.observation import rays_and_last_action
from tests.data.logs import METADATA, STEPS, logged_transitions, write_log
from tests.worlds import make_world

WORLD = make_world("oval")


def make_buffer(replicates):
    generators = [torch.Generator().manual_seed(seed) for seed in range(replicates)]
    return make_replay_buffer(64, 4, device="cpu", generators=generators)


@pytest.mark.parametrize("replicates", [1, 3])
def test_every_replicate_gets_every_transition_of_every_log_in_order(replicates, tmp_path):
    paths = [write_log(tmp_path / "a.mcap"), write_log(tmp_path / "b.mcap")]
    buffer = make_buffer(replicates)
    fill_from_logs(buffer, paths, replicates, WORLD.action)
    expected = torch.cat([load(path) for path in paths])
    assert len(buffer) == len(expected) == 2 * len(STEPS)
    for replicate in range(replicates):
        for key in KEYS:
            assert torch.equal(buffer[:][:, replicate].get(key), expected.get(key))


def test_agents_sample_different_minibatches_of_the_same_transitions(tmp_path):
    buffer = make_buffer(2)
    fill_from_logs(buffer, [write_log(tmp_path / "a.mcap")], 2, WORLD.action)
    items, replicates = buffer.sampler.sample(buffer.storage, 64)[0]
    assert not torch.equal(items[:, 0], items[:, 1])
    assert torch.equal(replicates, torch.arange(2).expand(64, 2))


def test_logs_that_fit_are_counted(tmp_path):
    paths = [write_log(tmp_path / "a.mcap"), write_log(tmp_path / "b.mcap")]
    assert check_logs(paths, WORLD) == 20


def test_a_log_that_says_nothing_of_its_sensor_is_taken_at_its_width(tmp_path):
    assert check_logs([write_log(tmp_path / "a.mcap", metadata={})], WORLD) == 10


def test_a_log_without_transitions_counts_for_nothing(tmp_path):
    empty = write_log(tmp_path / "a.mcap", logged_transitions()[:0])
    assert check_logs([empty], WORLD) == 0


BOTH = rays_and_last_action()


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        (
            {"sensor": Sensor(rays=9)},
            r"its observations have 7 values, the network reads 9 \(9 of rays\); "
            r"set sensor\.rays and observation as in the run that wrote it",
        ),
        ({"observation": BOTH}, r"have 7 values, the network reads 10 \(7 of rays, 3 of last_action\)"),
        (
            {"sensor": Sensor(rays=4), "observation": BOTH},
            r"its sensor has 7 rays over 180 degrees, this configuration's 4 rays over 180 degrees",
        ),
        (
            {"sensor": Sensor(field_of_view=120)},
            r"7 rays over 180 degrees, this .* 7 rays over 120 degrees; set sensor\.rays",
        ),
        (
            {"sensor": Sensor(max_range=15)},
            r"its sensor reaches 10\.0 m, this configuration's 15 m; set sensor\.max_range=10\.0",
        ),
        (
            {"sensor": Sensor(mount=0.2)},
            r"its rays begin 0\.0 m ahead of the car's middle, this configuration's 0\.2 m; set sensor\.mount=0\.0",
        ),
        (
            {"action": DiscreteActions(("forward", "left"), {"steer": (0.0, 1.0)})},
            r"its actions are \['forward', 'left', 'right'\], this car's are \['forward', 'left'\]",
        ),
    ],
    ids=["rays", "observed action", "rays and action", "field of view", "range", "mount", "actions"],
)
def test_a_log_of_another_car_is_refused(parts, message, tmp_path):
    with pytest.raises(LogError, match=message):
        check_logs([write_log(tmp_path / "a.mcap")], make_world("oval", **parts))


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"action_names": '["left", "right"]'}, r"its actions are \['left', 'right'\], this car's are"),
        ({"action_names": "left"}, "its metadata entry 'action_names' is not JSON"),
        (
            {"observation": '[["rays", 4, 0, 1], ["last_action", 3, 0, 1]]'},
            "its observations are 4 of rays, 3 of last_action, the network reads 7 of rays; set observation",
        ),
        ({"observation": "[7]"}, "its metadata entry 'observation' names no terms"),
        ({"sensor_mount_m": "1.5"}, r"its rays begin 1\.5 m ahead of the car's middle, this configuration's 0\.0 m"),
        ({"sensor_range_m": '"far"'}, "its metadata entry 'sensor_range_m' holds no numbers"),
        ({"sensor_range_m": "[10.0]"}, r"its sensor reaches \[10\.\] m"),
        ({"sensor_angles_rad": "[[1], [2, 3]]"}, "its metadata entry 'sensor_angles_rad' holds no numbers"),
        ({"sensor_angles_rad": "[]"}, "its sensor has no rays"),
        ({"sensor_angles_rad": json.dumps([0.0] * 6 + [float("nan")])}, "its sensor has 7 rays over nan degrees"),
    ],
    ids=str,
)
def test_a_log_with_other_metadata_is_refused(entry, message, tmp_path):
    path = write_log(tmp_path / "a.mcap", metadata=METADATA | entry)
    with pytest.raises(LogError, match=message):
        check_logs([path], WORLD)


@pytest.mark.parametrize("action", [-1, 3])
def test_an_action_that_there_is_not_is_refused(action, tmp_path):
    path = write_log(tmp_path / "a.mcap", logged_transitions(action=action))
    with pytest.raises(LogError, match=r"has actions .*; each must be 0 forward, 1 left or 2 right"):
        fill_from_logs(make_buffer(1), [path], 1, WORLD.action)


def test_a_missing_log_is_named(tmp_path):
    with pytest.raises(LogError, match=r"nowhere\.mcap"):
        check_logs([tmp_path / "nowhere.mcap"], WORLD)
