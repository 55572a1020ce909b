"""Many cars as Gymnasium sees them: the same as as many single ones.

Shapes: `N` cars.
"""

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode

import carrl
from carrl import Start, paper_reward, rays_and_last_action
from carrl.errors import ConfigError

MODES = list(AutoresetMode)


def make(num_envs=5, **options):
    return gymnasium.make_vec("carrl/Track-v0", num_envs=num_envs, **options)


def make_copies(num_envs, autoreset_mode, **options):
    """Single environments side by side, each in its own simulator."""
    return gymnasium.make_vec(
        "carrl/Track-v0",
        num_envs=num_envs,
        vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": autoreset_mode},
        **options,
    )


def assert_same(one, other):
    """Compares nested results of two environments, with their types."""
    assert type(one) is type(other)
    if isinstance(one, dict):
        for key, value in other.items():
            assert_same(one[key], value)
        # What none of the copies has a value of is missing there; here its mask is false.
        assert not any(value.any() for key, value in one.items() if key not in other)
    elif isinstance(one, tuple):
        for pair in zip(one, other, strict=True):
            assert_same(*pair)
    elif one.dtype == object:
        assert [None if each is None else np.asarray(each).tolist() for each in one] == [
            None if each is None else np.asarray(each).tolist() for each in other
        ]
    else:
        np.testing.assert_array_equal(one, other, strict=True)


@pytest.mark.parametrize("mode", MODES[:2])
@pytest.mark.parametrize(
    "options",
    [
        {"track": "paper"},
        {"track": "oval", "start": Start(anywhere=True, offset=0.5, heading_jitter=30, mirrored=True)},
        {"observation": rays_and_last_action(), "reward": paper_reward(-0.1, -0.3), "max_episode_steps": 15},
    ],
)
def test_all_cars_at_once_do_what_copies_of_the_single_environment_do(mode, options):
    ours, copies = make(autoreset_mode=mode, **options), make_copies(5, mode, **options)
    assert_same(ours.reset(seed=7), copies.reset(seed=7))
    rng = np.random.default_rng(0)
    ends = 0
    for _ in range(120):
        actions = rng.choice(3, size=5, p=[0.6, 0.2, 0.2])
        outcome = ours.step(actions)
        assert_same(outcome, copies.step(actions))
        ends += (outcome[2] | outcome[3]).sum()
    assert ends > 10


def test_spaces_and_metadata_are_those_of_copies():
    ours, copies = make(track="oval"), make_copies(5, AutoresetMode.NEXT_STEP, track="oval")
    for name in ("num_envs", "single_observation_space", "single_action_space", "observation_space", "action_space"):
        assert getattr(ours, name) == getattr(copies, name), name
    assert ours.metadata == copies.metadata
    assert isinstance(ours, gymnasium.vector.VectorEnv)
    assert ours.spec.id == "carrl/Track-v0"


@pytest.mark.parametrize("mode", MODES[:2])
def test_what_it_returns_lies_in_its_spaces(mode):
    env = make(autoreset_mode=mode, start=Start(anywhere=True))
    view, _ = env.reset(seed=1)
    env.action_space.seed(1)
    for _ in range(60):
        assert view in env.observation_space
        view, reward, terminated, truncated, _ = env.step(env.action_space.sample())
        assert reward.shape == terminated.shape == truncated.shape == (5,)
        assert (reward.dtype, terminated.dtype, truncated.dtype) == (np.float64, bool, bool)


def test_the_same_seed_gives_the_same_rollout_with_noise_too():
    options = {
        "sensor": carrl.Sensor(noise=0.2, dropout=0.1),
        "start": Start(anywhere=True, sample_track=True),
        "track": ["oval", "paper"],
    }
    one, other = make(**options), make(**options)
    assert_same(one.reset(seed=3), other.reset(seed=3))
    rng = np.random.default_rng(0)
    for _ in range(60):
        actions = rng.integers(3, size=5)
        assert_same(one.step(actions), other.step(actions))


def test_a_seed_of_a_list_belongs_to_its_car():
    env = make(3, start=Start(anywhere=True))
    _, by_number = env.reset(seed=10)
    _, by_list = env.reset(seed=[12, 11, 10])
    np.testing.assert_array_equal(by_number["pose"], by_list["pose"][::-1])


def test_without_a_seed_the_random_numbers_go_on():
    env, twin = make(start=Start(anywhere=True)), make(start=Start(anywhere=True))
    poses = [each.reset(seed=1)[1]["pose"] for each in (env, twin)]
    later = [each.reset()[1]["pose"] for each in (env, twin)]
    np.testing.assert_array_equal(*later)
    assert (later[0] != poses[0]).any()


def test_the_list_of_seeds_must_have_one_for_each_car():
    with pytest.raises(ConfigError, match="seed has 2 entries"):
        make(3).reset(seed=[1, 2])


def test_the_step_after_the_last_one_ignores_its_action_and_earns_nothing():
    env = make(2, max_episode_steps=4)
    first, _ = env.reset(seed=0)
    truncated = [env.step(np.zeros(2, dtype=int))[3].tolist() for _ in range(4)]
    assert truncated == [[False, False]] * 3 + [[True, True]]
    view, reward, terminated, truncated, infos = env.step(np.array([1, 2]))
    np.testing.assert_array_equal(view, first)
    assert not (reward.any() or terminated.any() or truncated.any())
    assert not infos["collision"].any()


def test_the_same_step_mode_keeps_the_last_view_of_each_ended_episode():
    env = make(2, max_episode_steps=1, autoreset_mode="SameStep")
    first, _ = env.reset()
    view, _, _, truncated, infos = env.step(np.array([0, 1]))
    assert truncated.all()
    np.testing.assert_array_equal(view, first)
    lone = carrl.GymTrackEnv()
    for car, action in enumerate((0, 1)):
        lone.reset()
        np.testing.assert_array_equal(infos["final_obs"][car], lone.step(action)[0])


def test_with_autoreset_disabled_a_mask_puts_cars_back_one_by_one():
    options = {"autoreset_mode": AutoresetMode.DISABLED, "max_episode_steps": 2}
    env, copies = make(3, **options), make_copies(3, AutoresetMode.DISABLED, max_episode_steps=2)
    assert_same(env.reset(seed=0), copies.reset(seed=0))
    for _ in range(2):
        assert_same(env.step(np.array([0, 1, 2])), copies.step(np.array([0, 1, 2])))
    with pytest.raises(gymnasium.error.ResetNeeded, match="car 0 has ended"):
        env.step(np.zeros(3, dtype=int))
    mask = np.array([True, False, False])
    assert_same(env.reset(options={"reset_mask": mask}), copies.reset(options={"reset_mask": mask}))
    with pytest.raises(gymnasium.error.ResetNeeded, match="car 1 has ended"):
        env.step(np.zeros(3, dtype=int))
    assert_same(env.reset(options={"reset_mask": ~mask}), copies.reset(options={"reset_mask": ~mask}))
    env.step(np.zeros(3, dtype=int))


@pytest.mark.parametrize("mask", [np.zeros(3, dtype=bool), np.ones(2, dtype=bool), [True, True, True]])
def test_a_reset_mask_of_another_form_is_refused(mask):
    with pytest.raises(ConfigError, match=r"bool array \[3\] with a true value"):
        make(3).reset(options={"reset_mask": mask})


def test_what_was_handed_out_neither_changes_later_nor_changes_what_follows():
    env, twin = make(), make()
    handed_out = [*env.reset(seed=0)]
    twin.reset(seed=0)
    kept = [value.copy() for value in (handed_out[0], handed_out[1]["pose"], handed_out[1]["gates_passed"])]
    actions = np.array([0, 1, 2, 0, 1])
    env.step(actions)
    twin.step(actions)
    actions[:] = 2
    for value, copy in zip((handed_out[0], handed_out[1]["pose"], handed_out[1]["gates_passed"]), kept, strict=True):
        np.testing.assert_array_equal(value, copy)
        value[:] = 0
    for _ in range(40):
        view, reward, *ends, infos = env.step(actions)
        assert_same((view, reward, *ends, infos), twin.step(actions))
        for array in (view, reward, *ends, infos["pose"], infos["gates_passed"]):
            array[:] = 0


def test_cars_take_turns_on_several_tracks():
    env = make(5, track=["oval", "paper"])
    assert [track.name for track in env.tracks] == ["oval", "paper"]
    _, infos = env.reset(seed=0)
    assert infos["track"].tolist() == [0, 1, 0, 1, 0]


def test_gymnasiums_wrappers_for_vectors_work():
    env = gymnasium.wrappers.vector.RecordEpisodeStatistics(make(2, max_episode_steps=3))
    env.reset(seed=0)
    for _ in range(3):
        *_, infos = env.step(np.zeros(2, dtype=int))
    assert infos["episode"]["l"].tolist() == [3, 3]


def test_a_misspelt_option_is_answered_with_all_that_there_are():
    with pytest.raises(ConfigError, match=r"keyword argument 'autoreset' .*num_envs.*autoreset_mode.*start"):
        make(autoreset="SameStep")


def test_an_unknown_autoreset_mode_is_refused():
    with pytest.raises(ConfigError, match="choose one of NextStep, SameStep, Disabled"):
        make(autoreset_mode="Later")


def test_actions_that_are_none_are_refused():
    env = make(2)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros(2, dtype=int))
    env.reset()
    for actions in ([0], [0, 3], [-1, 0]):
        with pytest.raises(gymnasium.error.InvalidAction, match="must be 2 numbers"):
            env.step(np.array(actions))


@pytest.mark.parametrize(
    ("actions", "found"),
    [
        ([1.9, 0.0], r"actions is an array \[2\] of float64"),
        (np.array([True, False]), r"actions is an array \[2\] of bool"),
        (np.zeros((2, 1), dtype=int), r"actions is an array \[2, 1\] of int64"),
        (1, r"actions is an array \[\] of int64"),
        ([0, [1]], r"actions is \[0, \[1\]\], no array"),
        (["0", "1"], r"actions is an array \[2\] of <U1"),
        (np.array([0, 2**64 - 1], dtype=np.uint64), r"actions\[1\] is 18446744073709551615"),
        ([0, -1], r"actions\[1\] is -1"),
    ],
)
def test_actions_of_another_type_or_shape_are_refused_in_one_sentence(actions, found):
    env = make(2)
    env.reset()
    wanted = r"must be 2 numbers in an array \[2\], each the whole number 0 forward, 1 left or 2 right$"
    with pytest.raises(ConfigError, match=f"^{found}.*{wanted}"):
        env.step(actions)


def test_integers_of_every_kind_are_actions():
    outcomes = []
    for kind in (list, np.array, torch.tensor, lambda each: np.array(each, dtype=np.uint8)):
        env = make(3)
        env.reset()
        outcomes.append(env.step(kind([0, 1, 2])))
    for outcome in outcomes[1:]:
        assert_same(outcome, outcomes[0])


@pytest.mark.parametrize("seed", [1.5, True, "1", -1, 2**63, [1, 2.5, 3], [1, True, 3], [1, 2, "3"]])
def test_seeds_are_whole_numbers_that_the_generators_take(seed):
    with pytest.raises(ConfigError, match=r"^seed(\[\d\])? is .*; it must be a whole number, at least 0"):
        make(3, start=Start(anywhere=True)).reset(seed=seed)


def test_numpys_integers_are_seeds_and_sizes():
    env, other = make(np.int64(3), start=Start(anywhere=True)), make(3, start=Start(anywhere=True))
    poses = [env.reset(seed=seed)[1]["pose"] for seed in (np.int64(5), np.array([5, 6, 7]))]
    poses.append(other.reset(seed=5)[1]["pose"])
    np.testing.assert_array_equal(poses[0], poses[1])
    np.testing.assert_array_equal(poses[0], poses[2])


def test_a_car_that_was_truncated_waits_for_its_reset_where_autoreset_is_disabled():
    env = make(2, max_episode_steps=1, autoreset_mode="Disabled")
    env.reset()
    assert env.step([0, 0])[3].all()
    with pytest.raises(gymnasium.error.ResetNeeded, match="car 0 has ended its episode"):
        env.step([0, 0])


@pytest.mark.parametrize("mode", MODES)
def test_infos_are_numbers_by_the_same_names_at_every_moment(mode):
    env = make(4, track=["oval", "paper"], autoreset_mode=mode, max_episode_steps=3)
    _, infos = env.reset(seed=0)
    names = set(infos)
    for _ in range(3):
        assert set(infos) == names
        assert all(value.dtype.kind in "ifb" for value in infos.values())
        *_, infos = env.step([0, 1, 2, 0])
    assert set(infos) - names == (
        {"final_obs", "_final_obs", "final_info", "_final_info"} if mode is MODES[1] else set()
    )


def test_episode_statistics_are_right_where_a_mask_puts_cars_back():
    env = gymnasium.wrappers.vector.RecordEpisodeStatistics(make(4, max_episode_steps=30, autoreset_mode="Disabled"))
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    returns, lengths, episodes = np.zeros(4), np.zeros(4, dtype=int), 0
    for _ in range(150):
        _, reward, terminated, truncated, infos = env.step(rng.choice(3, size=4, p=[0.4, 0.3, 0.3]))
        returns, lengths = returns + reward, lengths + 1
        ended = terminated | truncated
        if ended.any():
            np.testing.assert_allclose(infos["episode"]["r"][ended], returns[ended])
            np.testing.assert_array_equal(infos["episode"]["l"][ended], lengths[ended])
            returns[ended], lengths[ended], episodes = 0, 0, episodes + ended.sum()
            env.reset(options={"reset_mask": ended})
    assert episodes > 15
