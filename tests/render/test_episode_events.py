"""The story of an episode in words, and the way onto the disk that the exports share."""

import dataclasses

import numpy as np
import pytest

from carrl.errors import CarrlError
from carrl.files import write_whole
from carrl.log.trace import EpisodeTrace
from carrl.render.episode import direction, driven_ways, episode_events


def with_columns(trace, **columns):
    return EpisodeTrace(trace.scene, {**trace.columns, **columns})


def texts(trace):
    return [(event.row, event.text) for event in episode_events(trace)]


def test_the_story_is_told_in_the_order_of_the_steps(trace):
    assert texts(trace) == [
        (0, "episode 7 of car 2 on track square"),
        (7, "1 gate passed"),
        (13, "near a wall: 0.15 m ahead"),
        (13, "collision after 14 steps, reward -170 in all"),
    ]
    assert [event.level for event in episode_events(trace)] == ["info", "info", "warning", "error"]


def passing_one_a_step(trace, before=0, **changes):
    """The episode with a gate passed in each of its first eight steps."""
    steps = np.arange(len(trace)).clip(max=8) + before
    return with_columns(trace, gates_passed=steps, next_gates_passed=np.append(steps[1:], steps[-1]), **changes)


def test_the_gate_that_completes_a_lap_says_so(trace):
    gates = [text for _, text in texts(passing_one_a_step(trace)) if "gate" in text]
    assert gates[:5] == [
        "1 gate passed",
        "2 gates passed",
        "3 gates passed",
        "4 gates passed, lap 1 complete",
        "5 gates passed",
    ]
    assert gates[7:] == ["8 gates passed, lap 2 complete"]


def test_gates_are_counted_from_the_beginning_of_the_episode_though_it_is_missing(trace):
    story = texts(passing_one_a_step(trace, before=2, step=trace.columns["step"] + 3))
    assert story[0] == (0, "episode 7 of car 2 on track square, recorded from step 3")
    assert (1, "4 gates passed, lap 1 complete") in story


def test_laps_are_not_counted_where_it_is_unknown_which_gates_were_passed_before(trace):
    unknown = np.full(len(trace), -1)
    story = texts(passing_one_a_step(trace, step=trace.columns["step"] + 3, next_gate=unknown))
    assert not any("lap" in text for _, text in story)


def test_a_stay_near_a_wall_is_told_once(trace):
    terms = trace.columns["reward_terms"].copy()
    terms[:, 1] = [0, -20, -20, -20, 0, 0, -20, 0, 0, 0, 0, 0, 0, 0]
    near = [row for row, text in texts(with_columns(trace, reward_terms=terms)) if text.startswith("near a wall")]
    assert near == [1, 6]


def test_a_reward_without_gates_and_proximity_tells_of_gates_alone(trace):
    plain = EpisodeTrace(dataclasses.replace(trace.scene, reward_terms=("a", "b", "c", "d")), trace.columns)
    assert [row for row, _ in texts(plain)] == [0, 7, 13]


@pytest.mark.parametrize(
    ("terminated", "truncated", "end"),
    [(True, False, "collision"), (False, True, "time limit"), (False, False, "the record ends within the episode")],
)
def test_the_last_line_tells_why_it_ended(trace, terminated, truncated, end):
    flags = {"terminated": np.full((14, 1), terminated), "truncated": np.full((14, 1), truncated)}
    assert texts(with_columns(trace, **flags))[-1] == (13, f"{end} after 14 steps, reward -170 in all")


@pytest.mark.parametrize(("degrees", "words"), [(0, "ahead"), (30, "30° left"), (-90, "90° right"), (0.2, "ahead")])
def test_directions_are_counter_clockwise_from_the_heading(degrees, words):
    assert direction(np.radians(degrees)) == words


def test_the_way_of_a_step_is_unknown_where_the_next_step_is_missing(trace):
    gap = np.delete(np.arange(14), 5)
    holed = EpisodeTrace(trace.scene, {name: column[gap] for name, column in trace.columns.items()})
    rows, ways = driven_ways(holed)
    assert rows.tolist() == [0, 1, 2, 3, 5, 6, 7, 8, 9, 10, 11, 12]
    np.testing.assert_allclose(np.linalg.norm(ways[:, 1] - ways[:, 0], axis=1), 1.5, rtol=1e-5)


def test_a_file_that_cannot_be_written_leaves_nothing_behind(tmp_path):
    (tmp_path / "taken").mkdir()
    with pytest.raises(CarrlError, match=r"'.*taken' cannot be written: Is a directory; choose another place"):
        write_whole(tmp_path / "taken", b"content")
    with pytest.raises(CarrlError, match="cannot be written: No such file or directory"):
        write_whole(tmp_path / "absent" / "file", b"content")
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]
