"""The account of episodes."""

import torch
from tensordict import TensorDict

from carrl.data.source import EpisodeTracker


def batch(rewards, done, gates=None, steps=None):
    """Transitions of B cars and T steps from nested lists [B][T]; every end is a collision."""
    rewards, done = torch.tensor(rewards), torch.tensor(done)
    zeros = torch.zeros(rewards.shape, dtype=torch.int64)
    after = {
        "reward": rewards[..., None].float(),
        "done": done[..., None],
        "terminated": done[..., None],
        "gates_passed": zeros if gates is None else torch.tensor(gates),
        "step": zeros if steps is None else torch.tensor(steps),
        "track": zeros,
        "pose": torch.arange(rewards.numel() * 3.0).view(*rewards.shape, 3),
    }
    return TensorDict({"next": TensorDict(after, rewards.shape)}, rewards.shape)


def test_episodes_are_numbered_by_when_they_begin():
    tracker = EpisodeTracker(1, 2, gates_per_lap=8, time_step=0.1)
    first = batch([[1, 2, 3], [10, 20, 30]], [[False, True, False], [False, False, True]])
    tracker.follow(first)
    assert first["episode"].tolist() == [[0, 0, 2], [1, 1, 1]]
    assert first["car"].tolist() == [[0, 0, 0], [1, 1, 1]]
    second = batch([[4], [40]], [[False], [False]])
    tracker.follow(second)
    assert second["episode"].tolist() == [[2], [3]]


def test_returns_sum_up_across_batches_and_begin_anew_after_an_end():
    tracker = EpisodeTracker(1, 2, gates_per_lap=8, time_step=0.1)
    (ended,) = tracker.follow(batch([[1, 2, 3], [10, 20, 30]], [[False, True, False], [False, False, True]]))
    ended += tracker.follow(batch([[4], [40]], [[True], [True]]))[0]
    assert [(e.episode, e.env, e.episode_return, e.frame) for e in ended] == [
        (0, 0, 3.0, 4),
        (1, 1, 60.0, 6),
        (2, 0, 7.0, 8),
        (3, 1, 40.0, 8),
    ]
    assert tracker.frames == 8


def test_laps_are_whole_rounds_of_gates():
    tracker = EpisodeTracker(1, 1, gates_per_lap=8, time_step=0.1)
    ((episode,),) = tracker.follow(batch([[0.0]], [[True]], gates=[[17]], steps=[[345]]))
    assert (episode.gates, episode.laps, episode.length, episode.ended) == (17, 2, 345, "collision")


def test_an_episode_that_is_cut_ended_by_the_time_limit():
    step = batch([[0.0]], [[True]])
    step["next", "terminated"] = torch.zeros(1, 1, 1, dtype=torch.bool)
    ((episode,),) = EpisodeTracker(1, 1, gates_per_lap=8, time_step=0.1).follow(step)
    assert episode.ended == "time limit"


def test_an_episode_that_ended_at_no_wall_is_no_collision():
    step = batch([[0.0], [0.0]], [[True], [True]])
    step["next", "collided"] = torch.tensor([[[False]], [[True]]])
    (ended,) = EpisodeTracker(1, 2, gates_per_lap=8, time_step=0.1).follow(step)
    assert [episode.ended for episode in ended] == ["other end", "collision"]


def test_every_agent_has_an_account_of_its_own():
    alone = EpisodeTracker(1, 2, gates_per_lap=8, time_step=0.1)
    together = EpisodeTracker(2, 2, gates_per_lap=8, time_step=0.1)
    rewards, done = [[1, 2, 3], [10, 20, 30]], [[False, True, False], [False, False, True]]
    expected, all_four = batch(rewards, done), batch([*rewards, [5, 5, 5], [6, 6, 6]], [*done, [True] * 3, [False] * 3])
    (ended,) = alone.follow(expected)
    ended_of_first, ended_of_second = together.follow(all_four)
    assert ended_of_first == ended
    assert torch.equal(all_four[:2]["episode"], expected["episode"])
    assert all_four[2:]["episode"].tolist() == [[0, 2, 3], [1, 1, 1]]
    assert all_four[2:]["car"].tolist() == [[0, 0, 0], [1, 1, 1]]
    assert [(e.episode, e.frame, e.length) for e in ended_of_second] == [(0, 2, 0), (2, 4, 0), (3, 6, 0)]
    assert together.frames == 6


def test_times_are_those_before_each_step_and_go_on_from_batch_to_batch():
    tracker = EpisodeTracker(2, 2, gates_per_lap=8, time_step=0.1)
    first, second = (batch([[1] * 3] * 4, [[False, True, False]] * 4) for _ in range(2))
    ended = tracker.follow(first)
    ended = [before + after for before, after in zip(ended, tracker.follow(second), strict=True)]
    assert first["time_ns"].tolist() == [[0, 100_000_000, 200_000_000]] * 4
    assert second["time_ns"].tolist() == [[300_000_000, 400_000_000, 500_000_000]] * 4
    for of_agent in ended:
        times = [(episode.begin_ns, episode.end_ns) for episode in of_agent]
        assert times == [(0, 200_000_000)] * 2 + [(200_000_000, 500_000_000)] * 2


def test_an_episode_tells_where_it_ended():
    tracker = EpisodeTracker(1, 2, gates_per_lap=8, time_step=0.1)
    (ended,) = tracker.follow(batch([[1, 2], [3, 4]], [[False, True], [True, False]]))
    assert [(episode.env, episode.end_pose) for episode in ended] == [(1, (6.0, 7.0, 8.0)), (0, (3.0, 4.0, 5.0))]


def test_a_lap_is_as_many_gates_as_the_cars_own_track_has():
    tracker = EpisodeTracker(1, 2, gates_per_lap=[8, 5], time_step=0.1)
    step = batch([[0.0], [0.0]], [[True], [True]], gates=[[10], [10]])
    step["next", "track"] = torch.tensor([[0], [1]])
    (ended,) = tracker.follow(step)
    assert [(episode.track, episode.laps) for episode in ended] == [(0, 1), (1, 2)]
