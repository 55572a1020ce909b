"""What `scripts/faults resumes` does to runs, and that it finds out one that is not the run never killed."""

import json
import subprocess
import sys
from collections import Counter
from dataclasses import replace

import pytest

from benchmarks.child import ROOT, BenchError, environment
from benchmarks.log_faults import resumes
from benchmarks.log_faults.blow import CHECKPOINT, RENAMING, Blow, Watch, places_in, struck_s
from benchmarks.log_faults.contents import LogContents
from benchmarks.log_faults.resume import ANY_MOMENT, WRITING, Reference, Resume
from benchmarks.log_faults.same_run import RunContents, differences
from carrl.train.checkpoint import StateFile, load_checkpoint

TINY = ["compile=false", "track=oval", "env.num_envs=8", "trainer.frames=320", "replay_buffer.batch_size=16"]
TINY += ["trainer.frames_per_update=2", "env.max_steps=100"]


class StruckError(Exception):
    """What stands for a signal."""


@pytest.fixture
def struck(tmp_path, monkeypatch):
    """Saves two states of a run with a blow on the way, and returns what is in the folder afterwards."""

    def save_two(blow):
        def strike(number):
            raise StruckError

        watch = Watch(tmp_path, blow)
        monkeypatch.setattr(watch, "strike", strike)
        for patched in watch.patches():
            monkeypatch.setattr(patched.getter(), patched.attribute, patched.new)
        file = StateFile(tmp_path / "run", {}, 1.0)
        with pytest.raises(StruckError):
            for number in (1, 2):
                file.save({"number": number})
        return {path.name: load_checkpoint(path)["number"] for path in (tmp_path / "run" / "checkpoints").glob("*.pt")}

    return save_two


@pytest.mark.parametrize(
    ("blow", "left"),
    [
        (Blow(9, CHECKPOINT, 0, 0.5), {}),
        (Blow(9, CHECKPOINT, 1, 0.5), {"state.pt": 1}),
        (Blow(9, RENAMING, 0, 0.0), {}),
        (Blow(9, RENAMING, 0, 0.9), {"state.pt": 1}),
        (Blow(9, RENAMING, 1, 0.0), {"state.pt": 1}),
        (Blow(9, RENAMING, 1, 0.9), {"state-previous.pt": 1}),
        (Blow(9, RENAMING, 2, 0.0), {"state-previous.pt": 1}),
        (Blow(9, RENAMING, 2, 0.9), {"state-previous.pt": 1, "state.pt": 2}),
    ],
)
def test_a_blow_falls_where_it_is_to_fall(blow, left, struck):
    assert struck(blow) == left


def test_places_are_counted_in_a_run_that_is_only_watched(tmp_path, monkeypatch):
    watch = Watch(tmp_path)
    for patched in watch.patches():
        monkeypatch.setattr(patched.getter(), patched.attribute, patched.new)
    file = StateFile(tmp_path / "run", {}, 1.0)
    for number in (1, 2):
        file.save({"number": number})
    assert places_in(tmp_path) == Counter({CHECKPOINT: 2, RENAMING: 3})
    assert struck_s(tmp_path) is None


CONTENTS = RunContents(
    state={"learner.replicates.0.loss.weight": b"1", "cars.pose": b"2"},
    networks={"best.pt": b"3", "last.pt": b"4"},
    tables={"metrics.csv": [{"episode": "1"}]},
    log=LogContents("5", [b"6"], [b"7"], [b"8"], {"track.json": b"{}"}, {"run": "5", "seed": "0"}),
    summary={"finished": True},
    files={"train.mcap"},
)


def with_log(**changes):
    return replace(CONTENTS, log=replace(CONTENTS.log, **changes))


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        (replace(CONTENTS, state=CONTENTS.state | {"learner.replicates.0.loss.weight": b"0"}), "final parameters are"),
        (replace(CONTENTS, state={"learner.replicates.0.loss.weight": b"1"}), "state.pt is another one in cars.pose"),
        (replace(CONTENTS, networks=CONTENTS.networks | {"best.pt": b"0"}), "best.pt: not those"),
        (replace(CONTENTS, tables={"metrics.csv": []}), "metrics.csv: not those"),
        (replace(CONTENTS, summary={"finished": False}), "the run is not finished"),
        (replace(CONTENTS, files={"train.mcap", ".0.partial"}), "left over or missing: .0.partial"),
        (with_log(rows=[]), "the log's transitions"),
        (with_log(episodes=[b"0"]), "the log's episodes"),
        (with_log(metadata={"run": "5", "seed": "1"}), "the log's metadata"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_run_that_is_another_one_is_found_out(changed, words):
    assert words in "; ".join(differences(changed, CONTENTS))


def test_a_run_that_tells_of_other_wall_time_is_the_same():
    other = with_log(run="6", metrics=[], metadata={"run": "6", "seed": "0"})
    assert list(differences(other, CONTENTS)) == []


def test_kills_are_counted_by_signal_and_moment_and_faults_give_exit_code_1(monkeypatch, capsys, tmp_path):
    results = iter(
        [
            Resume("SIGTERM", ANY_MOMENT, 2, 1, "checkpoint", [0.5, 0.25, 1.5]),
            Resume("SIGKILL", WRITING, 1, 0, "checkpoint before", faults=["it is gone"]),
            Resume("SIGTERM", ANY_MOMENT, 1, 0, "configuration", [0.125]),
        ]
    )
    monkeypatch.setattr(resumes, "preload", lambda: None)
    monkeypatch.setattr(resumes, "run_to_the_end", lambda overrides: Reference(overrides, CONTENTS, 2.0, Counter()))
    monkeypatch.setattr(resumes, "kill_and_resume", lambda reference, number, draw: next(results))
    assert resumes.main(["--kills", "3", "--json", str(tmp_path / "resumes.json")]) == 1
    printed = capsys.readouterr().out
    rows = [line.split() for line in printed.splitlines() if line.startswith(("SIGTERM", "SIGKILL", "all "))]
    figures = {" ".join(row[:-7]): row[-7:] for row in rows}
    assert figures["SIGTERM at any moment"] == ["2", "1", "0", "1", "0", "0.38", "1.50"]
    assert figures["SIGKILL in the middle of writing a checkpoint"] == ["1", "1", "1", "0", "1", "-", "-"]
    assert figures["all"] == ["3", "2", "1", "1", "1", "0.38", "1.50"]
    assert "FAULT in kill 2, SIGKILL in the middle of writing a checkpoint: it is gone" in printed
    assert "2 of 3 ended as the run that nobody killed" in printed
    assert len(json.loads((tmp_path / "resumes.json").read_text())["resumes"]) == 3


def test_a_reference_that_fails_is_one_sentence(monkeypatch, capsys):
    def fail(overrides):
        raise BenchError(f"`carrl train {' '.join(overrides)}` failed: no such experiment")

    monkeypatch.setattr(resumes, "preload", lambda: None)
    monkeypatch.setattr(resumes, "run_to_the_end", fail)
    assert resumes.main(["--experiment", "none"]) == 1
    assert "scripts/faults resumes: `carrl train experiment=none" in capsys.readouterr().err


@pytest.mark.slow
def test_real_runs_are_killed_and_resumed():
    command = [sys.executable, "-m", "benchmarks.log_faults.resumes", "--kills", "3", "--interval", "0.1", *TINY]
    done = subprocess.run(command, cwd=ROOT, env=environment(), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "kill 3 of 3" in done.stderr
    assert "3 of 3 ended as the run that nobody killed" in done.stdout
