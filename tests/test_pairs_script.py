"""What `scripts/faults pairs` finds out about two commands that begin at once."""

import json
import subprocess
import sys
from collections import Counter
from dataclasses import replace

import pytest

from benchmarks.child import ROOT, BenchError, environment
from benchmarks.log_faults import pair as pair_module
from benchmarks.log_faults import pairs
from benchmarks.log_faults.contents import LogContents
from benchmarks.log_faults.pair import KINDS, RECOVERY, RESUME, RUN, SWEEP, Pair, References, judge, run_pair
from benchmarks.log_faults.same_run import RunContents

SENTENCE = "carrl: 'X' is in use by process 7; wait until it has ended, or choose another folder\n"
CONTENTS = RunContents(
    state={"learner.weight": b"1"},
    networks={"best.pt": b"2", "last.pt": b"3"},
    tables={"metrics.csv": [{"episode": "1"}]},
    log=LogContents("5", [b"6"], [b"7"], [b"8"], {"track.json": b"{}"}, {"run": "5", "seed": "0"}),
    summary={"finished": True, "seed": 1},
    files={"train.mcap"},
)
OTHER = replace(CONTENTS, state={"learner.weight": b"9"})


def references(folder):
    (folder / "begun").mkdir()
    return References(["trainer.frames=9"], {1: CONTENTS, 2: OTHER}, folder / "begun", CONTENTS, folder, CONTENTS.log)


def test_one_success_and_one_sentence_is_as_it_should_be():
    pair = judge(RUN, [(2, SENTENCE), (0, "results in X\n")])
    assert pair == Pair(RUN, [2, 0], SENTENCE.strip())


@pytest.mark.parametrize(
    ("outcomes", "words"),
    [
        ([(0, "done"), (0, "done")], "not one success but 2"),
        ([(2, SENTENCE), (2, SENTENCE)], "not one success but 0"),
        ([(0, "done"), (1, "Traceback\nValueError: no")], "not one sentence and exit code 2 but [0, 1]"),
        ([(0, "done"), (2, "Traceback\nValueError: no")], "not one sentence"),
        ([(0, "done"), (2, f"warning\n{SENTENCE}")], "not one sentence"),
        ([(0, "done"), (-9, "")], "not one sentence"),
    ],
)
def test_anything_else_is_a_fault(outcomes, words):
    [fault] = judge(RUN, outcomes).faults
    assert words in fault


@pytest.mark.parametrize(("winner", "kind"), [(0, RUN), (1, RUN), (0, RESUME)])
def test_what_the_winner_leaves_is_compared_with_its_own_reference(winner, kind, tmp_path, monkeypatch):
    outcomes = [(0, "done"), (2, SENTENCE)]
    monkeypatch.setattr(pair_module, "start_together", lambda *_: outcomes if winner == 0 else outcomes[::-1])
    left = [OTHER if winner and kind == RUN else CONTENTS]
    monkeypatch.setattr(pair_module, "read_run", lambda _: left[0])
    made = references(tmp_path)
    assert run_pair(kind, made).faults == []
    left[0] = CONTENTS if winner else OTHER
    assert "the final parameters are others" in run_pair(kind, made).faults[0]


def test_a_sweep_and_a_recovery_that_left_nothing_are_found_out(tmp_path, monkeypatch):
    monkeypatch.setattr(pair_module, "start_together", lambda *_: [(0, "done"), (2, SENTENCE)])
    made = references(tmp_path)
    for kind, words in ((SWEEP, "jobs are not finished but []"), (RECOVERY, "LogError")):
        assert words in run_pair(kind, made).faults[0]


def test_pairs_are_counted_by_kind_and_faults_give_exit_code_1(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(pairs, "preload", lambda: None)
    monkeypatch.setattr(pairs, "make_references", lambda *_: None)
    results = {
        RUN: Pair(RUN, [0, 2], "carrl: 'X' has a run already"),
        RESUME: Pair(RESUME, [0, 2], SENTENCE.strip()),
        SWEEP: Pair(SWEEP, [0, 0], faults=["both succeeded"]),
        RECOVERY: Pair(RECOVERY, [2, 0], "carrl: 'Y' exists"),
    }
    monkeypatch.setattr(pairs, "run_pair", lambda kind, _: results[kind])
    assert pairs.main(["--pairs", "8", "--json", str(tmp_path / "pairs.json")]) == 1
    printed = capsys.readouterr().out
    rows = {line.split()[0]: line.split()[1:] for line in printed.splitlines() if line.startswith((*KINDS, "all "))}
    assert rows[RUN] == ["2", "2", "0", "2", "0"]
    assert rows[RESUME] == ["2", "2", "2", "0", "0"]
    assert rows[SWEEP] == ["2", "0", "0", "0", "2"]
    assert rows["all"] == ["8", "6", "2", "4", "2"]
    assert "6 of 8 lost nothing" in printed
    assert "FAULT in pair 3, sweep: both succeeded" in printed
    kept = json.loads((tmp_path / "pairs.json").read_text())["pairs"]
    assert Counter(pair["kind"] for pair in kept) == dict.fromkeys(KINDS, 2)


def test_a_reference_that_fails_is_one_sentence(monkeypatch, capsys):
    def fail(*_):
        raise BenchError("`carrl train` failed: no room")

    monkeypatch.setattr(pairs, "preload", lambda: None)
    monkeypatch.setattr(pairs, "make_references", fail)
    assert pairs.main([]) == 1
    assert "scripts/faults pairs: `carrl train` failed: no room" in capsys.readouterr().err


@pytest.mark.slow
def test_real_commands_are_started_at_once():
    size = ["--pairs", "3", "--frames", "400"]
    command = [sys.executable, "-m", "benchmarks.log_faults.pairs", *size, "--kinds", RUN, RESUME, SWEEP]
    done = subprocess.run(command, cwd=ROOT, env=environment(), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "3 of 3 lost nothing" in done.stdout
