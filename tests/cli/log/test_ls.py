"""`carrl log ls`: which episodes it lists, in which order, how."""

import json

import pytest

from carrl.cli.main import main
from tests.cli.log.conftest import write_log


@pytest.fixture
def numbers(run, log_path):
    """Lists the numbers of the episodes that are shown with some flags."""

    def list_numbers(*flags):
        return [row["episode"] for row in json.loads(run("ls", log_path, "--json", *flags))]

    return list_numbers


def test_it_has_a_row_for_each_ended_episode_under_a_title_that_counts_them(run, log_path):
    title, *table = run("ls", log_path).splitlines()
    assert title.endswith("train.mcap: 5 episodes ended, 5 shown")
    assert table == [
        "episode  env  begin s  steps  return  gates  laps  ended",
        "      0    0     0.00      5    -200      0     0  collision",
        "      1    1     0.00      7    -150      1     0  collision",
        "      2    2     0.00     12     200      4     1  time limit",
        "      3    0     0.50      9     150      3     0  time limit",
        "      4    1     0.70      6    -200      0     0  collision",
    ]


@pytest.mark.parametrize(
    ("flags", "expected"),
    [
        ([], [0, 1, 2, 3, 4]),
        (["--reverse"], [4, 3, 2, 1, 0]),
        (["--sort", "return"], [2, 3, 1, 0, 4]),
        (["--sort", "return", "--reverse"], [4, 0, 1, 3, 2]),
        (["--sort", "length"], [2, 3, 1, 4, 0]),
        (["--sort", "time"], [0, 1, 2, 3, 4]),
        (["--crashed"], [0, 1, 4]),
        (["--lapped"], [2]),
        (["--crashed", "--lapped"], []),
        (["--env", "1"], [1, 4]),
        (["--env", "0", "--env", "2"], [0, 2, 3]),
        (["--limit", "2"], [0, 1]),
        (["--limit", "0"], []),
        (["--sort", "return", "--limit", "1"], [2]),
    ],
)
def test_flags_choose_and_order_the_episodes(numbers, flags, expected):
    assert numbers(*flags) == expected


def test_the_title_tells_how_many_are_left_out(run, log_path):
    title, heading = run("ls", log_path, "--lapped", "--crashed").splitlines()
    assert title.endswith("5 episodes ended, 0 shown")
    assert heading.startswith("episode")


def test_as_json_a_row_has_what_the_log_notes_of_the_episode(run, log_path):
    row = json.loads(run("ls", log_path, "--json"))[2]
    assert row == {
        "episode": 2,
        "env": 2,
        "track": 0,
        "frame": 36,
        "begin_ns": 0,
        "end_ns": 1_200_000_000,
        "episode_return": 200.0,
        "length": 12,
        "gates": 4,
        "laps": 1,
        "ended": "time limit",
        "end_pose": [16.0, 3.0, 0.0],
        "track_name": "square",
    }


def test_of_several_tracks_the_names_are_told(run, tmp_path):
    path = write_log(tmp_path / "two.mcap", ("square", "Nürburgring, mirrored"))
    lines = run("ls", path).splitlines()
    assert lines[1].split()[-2:] == ["ended", "track"]
    assert [line.rpartition("  ")[2] for line in lines[2:4]] == ["square", "Nürburgring, mirrored"]


def test_an_order_that_there_is_none_is_refused(capsys, log_path):
    assert main(["log", "ls", str(log_path), "--sort", "colour"]) == 2
    assert "invalid choice: 'colour'" in capsys.readouterr().err
