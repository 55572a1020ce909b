"""The log for robotics viewers: frames, scenes and plots agree with the episode."""

import dataclasses
import importlib
import sys

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from carrl.errors import CarrlError
from carrl.log.trace import EpisodeTrace
from carrl.render.colours import DARK, rgb
from tests.driven_episode import MOUNT

pytest.importorskip("foxglove", reason="foxglove-sdk is not installed")

from carrl.export.foxglove import identifiers, write_viewer_log

ACTIONS = [rgb(colour) for colour in DARK.actions]

TOPICS = {
    "/track": ("foxglove.SceneUpdate", 1),
    "/drive": ("foxglove.SceneUpdate", 1),
    "/drive/poses": ("foxglove.PosesInFrame", 1),
    "/tf": ("foxglove.FrameTransform", 15),
    "/car": ("foxglove.SceneUpdate", 1),
    "/car/pose": ("foxglove.PoseInFrame", 15),
    "/car/scan": ("foxglove.LaserScan", 15),
    "/car/rays": ("foxglove.SceneUpdate", 15),
    "/action_value": ("carrl.ActionValue", 14),
    "/reward": ("carrl.Reward", 14),
    "/ranges": ("carrl.Ranges", 15),
    "/epsilon": ("carrl.Epsilon", 14),
    "/action": ("carrl.Action", 14),
    "/events": ("foxglove.Log", 4),
}
"""Of each topic its schema, and how many messages 14 steps make."""


class ViewerLog:
    """The decoded messages of each topic, and when they were logged, ns."""

    def __init__(self, path):
        self.messages, self.times, self.schemas, self.order = {}, {}, {}, []
        with path.open("rb") as file:
            reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
            for schema, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
                self.messages.setdefault(channel.topic, []).append(decoded)
                self.times.setdefault(channel.topic, []).append(message.log_time)
                self.schemas[channel.topic] = schema.name
                self.order.append(message.log_time)
            self.metadata = {record.name: record.metadata for record in reader.iter_metadata()}

    def column(self, topic, *fields):
        """Numbers of a topic's messages, [messages, fields]."""
        return np.array([[getattr(message, field) for field in fields] for message in self.messages[topic]])


@pytest.fixture(scope="module")
def path(trace, tmp_path_factory):
    path = tmp_path_factory.mktemp("viewer") / "episode.mcap"
    write_viewer_log(path, trace, "an episode")
    return path


@pytest.fixture(scope="module")
def log(path):
    return ViewerLog(path)


def places(points):
    return np.array([(point.x, point.y) for point in points])


def shade(colour):
    """A colour of a message as three numbers of 0..255."""
    return tuple(round(255 * part) for part in (colour.r, colour.g, colour.b))


def test_every_topic_has_its_schema_and_a_message_for_each_step(log):
    assert {topic: (log.schemas[topic], len(log.messages[topic])) for topic in log.messages} == TOPICS


def test_messages_have_the_times_of_the_run_s_log_and_are_in_their_order(log, trace):
    steps = 5_000_000_000 + 100_000_000 * np.arange(15)
    assert log.times["/tf"] == steps.tolist()
    assert log.times["/action_value"] == steps[:14].tolist()
    stamps = [message.timestamp.seconds * 10**9 + message.timestamp.nanos for message in log.messages["/tf"]]
    assert stamps == steps.tolist()
    assert log.order == sorted(log.order)
    assert log.times["/track"] == [5_000_000_000]


def test_the_car_s_frame_is_where_the_car_was(log, trace):
    for message, pose, (x, y, heading) in zip(log.messages["/tf"], log.messages["/car/pose"], trace.poses, strict=True):
        assert (message.parent_frame_id, message.child_frame_id, pose.frame_id) == ("world", "car", "world")
        for place, turn in ((message.translation, message.rotation), (pose.pose.position, pose.pose.orientation)):
            assert (place.x, place.y, place.z) == pytest.approx((x, y, 0))
            assert 2 * np.arctan2(turn.z, turn.w) == pytest.approx(heading)


def test_the_rays_end_in_the_world_where_the_log_has_them(log, trace):
    for message, (x, y, heading), ends in zip(log.messages["/car/rays"], trace.poses, trace.ray_ends(), strict=True):
        (entity,) = message.entities
        assert entity.frame_id == "car"
        begin, end = places(entity.lines[0].points).reshape(-1, 2, 2).transpose(1, 0, 2)
        np.testing.assert_array_equal(begin, 0)
        turn = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
        np.testing.assert_allclose((x, y) + end @ turn.T, ends, rtol=1e-6)


def test_a_ray_that_meets_nothing_reads_infinity_in_the_scan(log, trace):
    scans = np.array([message.ranges for message in log.messages["/car/scan"]])
    np.testing.assert_allclose(scans, np.where(trace.ranges < 10, trace.ranges, np.inf))
    assert np.isinf(scans).any()
    first = log.messages["/car/scan"][0]
    assert (first.frame_id, first.start_angle, first.end_angle) == ("car", -np.pi / 2, np.pi / 2)


def test_the_track_is_drawn_once_with_its_walls_and_gates(log, trace):
    centreline, gates, start, walls = log.messages["/track"][0].entities[0].lines
    np.testing.assert_allclose(places(walls.points), trace.track.walls.reshape(-1, 2))
    np.testing.assert_allclose(places([*gates.points, *start.points]), trace.track.gates.reshape(-1, 2))
    np.testing.assert_allclose(places(centreline.points)[::2], trace.track.centreline)
    assert [shade(line.color) for line in (walls, gates, start)] == [*map(rgb, (DARK.wall, DARK.gate, DARK.start))]


def test_the_driven_line_has_the_colours_of_the_actions(log, trace):
    (line,) = log.messages["/drive"][0].entities[0].lines
    ways = places(line.points).reshape(-1, 2, 2)
    np.testing.assert_allclose(ways, np.stack([trace.poses[:-1, :2], trace.poses[1:, :2]], axis=1), rtol=1e-6)
    assert [shade(colour) for colour in line.colors] == [ACTIONS[action] for action in trace.actions for _ in range(2)]
    drawn = places([pose.position for pose in log.messages["/drive/poses"][0].poses])
    np.testing.assert_allclose(drawn, trace.poses[:, :2], rtol=1e-6)


def test_the_car_is_drawn_once_and_goes_with_its_frame(log, trace):
    (entity,) = log.messages["/car"][0].entities
    assert (entity.frame_id, entity.frame_locked) == ("car", True)
    assert entity.cylinders[0].size.x == 2 * trace.scene.body_radius
    assert len(entity.arrows) == 1


def test_what_is_plotted_has_a_field_for_each_name(log, trace):
    np.testing.assert_allclose(log.column("/action_value", "forward", "left", "right"), trace.columns["action_value"])
    np.testing.assert_allclose(log.column("/reward", *trace.scene.reward_terms), trace.reward_terms)
    sums = np.column_stack([trace.rewards, trace.rewards.cumsum()])
    np.testing.assert_allclose(log.column("/reward", "reward", "return_so_far"), sums)
    np.testing.assert_allclose(
        log.column("/ranges", "right_90", "right_45", "ahead", "left_45", "left_90"), trace.ranges
    )
    np.testing.assert_allclose(log.column("/epsilon", "epsilon")[:, 0], trace.columns["epsilon"])


def test_actions_are_plotted_by_name(log, trace):
    names = log.messages["/action"][0].DESCRIPTOR.enum_types_by_name
    assert [value.name for value in names["Action"].values] == ["forward", "left", "right"]
    assert [value.name for value in names["Choice"].values] == ["greedy", "random"]
    found = log.column("/action", "action", "choice")
    np.testing.assert_array_equal(found, np.stack([trace.actions, trace.exploratory], axis=1))


def test_events_are_log_lines_with_levels(log):
    lines = [(message.level, message.message) for message in log.messages["/events"]]
    assert lines[1:3] == [(2, "1 gate passed"), (3, "near a wall: 0.15 m ahead")]
    assert lines[3][0] == 4
    assert log.times["/events"][1] == 5_700_000_000


def test_the_log_says_which_episode_it_is(log):
    assert log.metadata["episode"] == {
        "title": "an episode",
        "episode": "7",
        "car": "2",
        "track": "square",
        "steps": "14",
        "episode_return": "-170",
        "gates": "1",
        "ended": "collision",
    }


def test_the_same_episode_gives_the_same_bytes(path, trace, tmp_path):
    write_viewer_log(tmp_path / "again.mcap", trace, "an episode")
    assert (tmp_path / "again.mcap").read_bytes() == path.read_bytes()


def test_names_that_protobuf_does_not_allow_are_replaced_by_others(trace, tmp_path):
    assert identifiers(["turn left!", "turn left?", "3", ""]) == ["turn_left", "turn_left_1", "_3", "_"]
    named = dataclasses.replace(trace.scene, action_names=("straight on", "left-", "left+"))
    write_viewer_log(tmp_path / "named.mcap", EpisodeTrace(named, trace.columns), "an episode")
    found = ViewerLog(tmp_path / "named.mcap").column("/action_value", "straight_on", "left", "left_2")
    np.testing.assert_allclose(found, trace.columns["action_value"])


def test_other_cars_are_drawn_once_and_go_with_frames_of_their_own(among_others, tmp_path):
    write_viewer_log(tmp_path / "others.mcap", among_others, "others")
    log = ViewerLog(tmp_path / "others.mcap")
    (scene,) = log.messages["/other_cars"]
    frames = [entity.frame_id for entity in scene.entities]
    assert (frames, len({entity.id for entity in scene.entities})) == (["other_car_1", "other_car_2"], 2)
    assert [shade(entity.cylinders[0].color) for entity in scene.entities] == [rgb(DARK.other_car)] * 2
    for car, frame in enumerate(frames):
        moves = [message for message in log.messages["/tf"] if message.child_frame_id == frame]
        assert {message.parent_frame_id for message in moves} == {"world"}
        found = [(move.translation.x, move.translation.y, move.rotation.z) for move in moves]
        x, y, heading = among_others.others[:, car].T
        np.testing.assert_allclose(found, np.column_stack([x, y, np.sin(heading / 2)]), rtol=1e-6)
    own = [message for message in log.messages["/tf"] if message.child_frame_id == "car"]
    np.testing.assert_allclose([move.translation.x for move in own], among_others.poses[:, 0], rtol=1e-6)


def test_without_foxglove_one_is_told_what_to_install(monkeypatch):
    monkeypatch.delitem(sys.modules, "carrl.export.foxglove")
    monkeypatch.setitem(sys.modules, "foxglove", None)
    with pytest.raises(CarrlError, match=r"need foxglove-sdk, which is not installed; pip install 'carrl\[export\]'"):
        importlib.import_module("carrl.export.foxglove")


def test_a_car_with_pedals_is_a_box_and_its_numbers_have_their_names(pedals, tmp_path):
    write_viewer_log(tmp_path / "pedals.mcap", pedals, "pedals")
    log = ViewerLog(tmp_path / "pedals.mcap")
    actions = [(message.steer, message.pedal) for message in log.messages["/action"]]
    np.testing.assert_allclose(actions, pedals.controls, rtol=1e-6)
    np.testing.assert_allclose([message.speed for message in log.messages["/speed"]], pedals.state("speed"), rtol=1e-6)
    assert {"/angles", "/accelerations", "/yaw_rate", "/choice"} <= set(log.messages)
    (entity,) = log.messages["/car"][0].entities
    assert (len(entity.cylinders), [(cube.size.x, cube.size.y) for cube in entity.cubes]) == (0, [(4.0, 1.8)])
    scan = log.messages["/car/scan"][0]
    assert (scan.pose.position.x, scan.pose.position.y) == (MOUNT, 0)
