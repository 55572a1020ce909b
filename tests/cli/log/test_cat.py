"""`carrl log cat`: lines for people, JSON lines for programs."""

import gc
import json
import subprocess
import sys
import tracemalloc

import numpy as np
import pytest

import carrl.log
from carrl.cli.main import main
from carrl.log.codec import tensordict_of
from carrl.log.writer import LogWriter
from tests.cli.log.conftest import SCHEMA, columns_of


@pytest.fixture
def rows(run, log_path):
    """The JSON lines of some flags."""

    def read(*flags):
        return [json.loads(line) for line in run("cat", log_path, "--json", *flags).splitlines()]

    return read


def test_every_transition_is_a_json_line_with_the_numbers_of_the_log(rows, log_path):
    found, columns = rows(), carrl.log.read_columns(log_path)
    assert len(found) == 54
    assert list(found[0]) == [column.name for column in SCHEMA.columns]
    for column in SCHEMA.columns:
        values = np.array([row[column.name] for row in found], dtype=columns[column.name].dtype)
        expected = np.where(np.isfinite(columns[column.name]), columns[column.name], np.nan).reshape(values.shape)
        np.testing.assert_array_equal(values, expected.astype(values.dtype))
    assert (found[4]["reward"], found[12]["reward"], found[12]["terminated"]) == (0.0, -200.0, True)


def test_what_is_no_number_is_null(run, log_path):
    lines = run("cat", log_path, "--json", "--episode", "1").splitlines()
    assert json.loads(lines[2])["action_value"] == [None, None, None]
    assert "NaN" not in lines[2] and "Infinity" not in lines[2]
    first = run("cat", log_path, "--json", "--topic", "/metrics", "--limit", "1")
    assert json.loads(first)["loss"] is None


@pytest.mark.parametrize(
    ("flags", "count"),
    [
        (["--episode", "2"], 12),
        (["--episode", "2", "--episode", "0"], 17),
        (["--env", "1"], 18),
        (["--begin", "1.0"], 24),
        (["--end", "0.1"], 3),
        (["--begin", "0.5", "--end", "0.7", "--env", "0"], 2),
        (["--limit", "7"], 7),
        (["--limit", "0"], 0),
        (["--episode", "99"], 0),
        (["--topic", "/episodes"], 5),
        (["--topic", "/episodes", "--env", "0"], 2),
        (["--topic", "/episodes", "--episode", "4"], 1),
        (["--topic", "/episodes", "--begin", "1.25"], 2),
        (["--topic", "/episodes", "--end", "0.5"], 3),
        (["--topic", "/metrics"], 3),
    ],
)
def test_flags_choose_among_the_messages(rows, flags, count):
    assert len(rows(*flags)) == count


def test_a_line_for_people_tells_one_transition(run, log_path):
    lines = run("cat", log_path, "--episode", "1").splitlines()
    assert lines[3] == (
        "0.30 s  episode 1 step 3 car 1  forward (random)  reward 0  at 11.50 3.50 heading 0°  "
        "observed 0.23 0.33 0.43 0.53 0.63  Q 10.3 11.3 12.3"
    )
    assert lines[6].startswith("0.60 s  episode 1 step 6 car 1  forward  reward -200")
    assert lines[6].endswith("terminated")


def test_lines_for_people_tell_episodes_and_metrics(run, log_path):
    first = run("cat", log_path, "--topic", "/episodes").splitlines()[1]
    assert first == "0.70 s  episode 1 car 1: 7 steps, return -150, 1 gate, 0 laps, collision at 13.50 3.00"
    first, second, _ = run("cat", log_path, "--topic", "/metrics").splitlines()
    assert first == "frame 18: 5 updates, loss nan, TD error 0.5, Q 10, epsilon 0.1, 1,000 frames/s"
    assert "loss 1," in second


def test_metrics_know_no_episode_car_or_time(refused, log_path):
    assert refused("cat", log_path, "--topic", "/metrics", "--env", "1").endswith("/metrics has none of them")


def test_a_span_that_ends_before_it_begins_is_refused(refused, log_path):
    assert refused("cat", log_path, "--begin", "2", "--end", "1") == "--end is 1 s; it must be later than --begin, 2 s"


@pytest.mark.parametrize("flags", [["--episode", "-1"], ["--begin", "nan"], ["--limit", "two"], ["--topic", "/poses"]])
def test_a_flag_without_sense_is_refused(capsys, log_path, flags):
    assert main(["log", "cat", str(log_path), *flags]) == 2
    assert f"argument {flags[0]}: " in capsys.readouterr().err


def test_a_reader_that_has_seen_enough_ends_it_without_a_complaint(tmp_path):
    path = long_log(tmp_path, 2_000)
    command = [sys.executable, "-m", "carrl.cli.main", "log", "cat", str(path), "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        json.loads(process.stdout.readline())
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait() == 0


def test_memory_does_not_grow_with_the_log(tmp_path, monkeypatch):
    def peak(rounds):
        path = long_log(tmp_path, rounds)
        gc.collect()
        gc.freeze()  # or what earlier tests left decides when garbage is collected
        tracemalloc.start()
        main(["log", "cat", str(path), "--json"])
        size = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        gc.unfreeze()
        return size

    monkeypatch.setattr("builtins.print", lambda line: None)
    peak(100)
    assert peak(1_200) < 1.5 * peak(300)


def long_log(folder, rounds):
    """A log of so many rounds of three transitions, a hundred of them to a chunk."""
    path = folder / f"{rounds}.mcap"
    first = columns_of(0, 1)
    with LogWriter(path, schema=SCHEMA, attachments={}, metadata={}) as writer:
        for _ in range(rounds // 100):
            many = {name: np.repeat(values, 100, axis=0) for name, values in first.items()}
            writer.write(tensordict_of(many, SCHEMA))
            writer.flush()
    return path
