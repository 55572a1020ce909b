"""What `scripts/faults` does to logs and runs, and that it finds out what does not keep its promises."""

import json
import random
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.child import ROOT, BenchError, environment
from benchmarks.log_faults import check as check_module
from benchmarks.log_faults import kill, kills, mutations, resumes
from benchmarks.log_faults.check import check
from benchmarks.log_faults.contents import LogContents, places_in, rows_of
from benchmarks.log_faults.damage import DAMAGES, damage
from benchmarks.log_faults.kill import Kill
from benchmarks.log_faults.sample import Piece, read_sample
from benchmarks.log_faults.training import Note
from carrl.log import read_columns, recover
from carrl.log.codec import tensordict_of
from carrl.log.messages import Episode, Metrics
from carrl.log.schema import TRANSITIONS
from carrl.log.writer import LogWriter
from tests.logs import make_schema

BATCHES, BATCH = 8, 12


def write_log(path, seed):
    draw = np.random.default_rng(seed)
    with LogWriter(
        path, schema=make_schema(), attachments={"config.yaml": b"seed: %d\n" % seed, "track.json": b"{}"}, metadata={}
    ) as writer:
        for number in range(BATCHES):
            columns = {c.name: draw.random((BATCH, *c.shape)).astype(c.dtype) for c in make_schema().columns}
            columns["time_ns"] = np.arange(number * BATCH, (number + 1) * BATCH)
            writer.write(tensordict_of(columns, make_schema()))
            end = int(columns["time_ns"][-1])
            writer.write_episode(Episode(number, 0, 0, number, 0, end, -1.5, 5, 1, 0, "collision", (1.0, 2.0, 3.0)))
            writer.write_metrics(
                Metrics(number, seed, float("nan"), 1234.5, {"td_error": 1.5, "action_value": -2.0, "epsilon": 0.99})
            )
            writer.flush()


@pytest.fixture(scope="module")
def samples(tmp_path_factory):
    """The logs of two short runs."""
    folder = tmp_path_factory.mktemp("logs")
    for seed in (0, 1):
        write_log(folder / f"{seed}.mcap", seed)
    return tuple(read_sample(folder / f"{seed}.mcap") for seed in (0, 1))


def test_no_damage_makes_recovery_or_a_reader_break_its_promises(samples, tmp_path):
    outcomes = [check(damage(random.Random(number), *samples)[1], samples, tmp_path) for number in range(200)]
    assert [outcome.faults for outcome in outcomes if outcome.faults] == []
    assert sum(outcome.noticed for outcome in outcomes) > 180
    assert {outcome.metadata_lost for outcome in outcomes} == {True, False}


def test_a_file_of_which_nothing_is_left_is_told_apart(samples, tmp_path):
    for content in (b"", b"noise", samples[0].content[8:300]):
        outcome = check(content, samples, tmp_path)
        assert (outcome.kept, outcome.faults) == (None, [])


def test_the_same_seed_makes_the_same_damage_and_another_one_another(samples):
    damaged = [damage(random.Random(seed), *samples) for seed in (3, 3, 4)]
    assert damaged[0] == damaged[1] != damaged[2]


@pytest.mark.parametrize("name", DAMAGES)
def test_every_kind_of_damage_changes_a_log_and_bears_an_empty_file(samples, name):
    changed = [DAMAGES[name](random.Random(seed), samples[0].content, *samples) for seed in range(20)]
    assert sum(content != samples[0].content for content in changed) > 15
    assert isinstance(DAMAGES[name](random.Random(0), b"", *samples), bytes)


def test_a_sample_tells_what_each_of_its_pieces_holds(samples):
    chunks = [piece for piece in samples[0].pieces if TRANSITIONS in piece.holds]
    assert [piece.holds for piece in chunks] == [
        {TRANSITIONS: range(begin, begin + BATCH)} for begin in range(0, BATCHES * BATCH, BATCH)
    ]
    assert all(samples[0].content[piece.begin :].startswith(piece.content) for piece in samples[0].pieces)


def lying(change):
    """A recovery that changes what a log says before it is recovered."""

    def recover_changed(source, target):
        columns = change(read_columns(source))
        with LogWriter(source, schema=make_schema(), attachments={}, metadata={}) as writer:
            writer._run = int(recover_changed.run, 16)
            writer.write(tensordict_of(columns, make_schema()))
        return recover(source, target)

    return recover_changed


CHANGES = {
    "loses": (lambda columns: {name: values[:-1] for name, values in columns.items()}, "lacks what is in an undamaged"),
    "invents": (lambda columns: columns | {"reward": columns["reward"] + 1}, "has what was never written"),
    "repeats": (lambda columns: {name: np.repeat(values, 2, 0) for name, values in columns.items()}, "more than once"),
    "swaps": (lambda columns: columns | {"state": columns["state"][::-1].copy()}, "has what was never written"),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_recovery_that_does_what_it_must_not_is_found_out(samples, tmp_path, monkeypatch, name):
    change, words = CHANGES[name]
    liar = lying(change)
    liar.run = samples[0].says.run

    def recover_changed(source, target):
        changed = tmp_path / "changed.mcap"
        changed.write_bytes(source.read_bytes())
        recovery = liar(changed, target)
        return replace(recovery, metadata_lost=True)

    monkeypatch.setattr(check_module, "recover", recover_changed)
    faults = check(samples[0].content, samples, tmp_path).faults
    assert any(words in fault for fault in faults), faults


def test_a_recovery_that_fails_is_a_fault_and_not_the_end(samples, tmp_path, monkeypatch):
    def fail(*_):
        raise IndexError("list index out of range")

    monkeypatch.setattr(check_module, "recover", fail)
    assert check(samples[0].content, samples, tmp_path).faults == ["IndexError: list index out of range"]


def test_a_verification_that_is_blind_is_found_out(samples, tmp_path, monkeypatch):
    content = samples[0].content[:-9] + b"x" + samples[0].content[-8:]
    assert check(content, samples, tmp_path).noticed
    monkeypatch.setattr(check_module, "verify", lambda path: None)
    monkeypatch.setattr(check_module, "read_contents", lambda path: samples[0].says)
    outcome = check(content, samples, tmp_path)
    assert (outcome.noticed, outcome.spared) == (False, True)


def test_places_of_items_are_found_only_in_order_and_once():
    assert places_in([b"a", b"b", b"c"], [b"a", b"c"]) == [0, 2]
    assert places_in([b"a"], []) == []
    for wrong in ([b"c", b"a"], [b"a", b"a"], [b"d"]):
        assert places_in([b"a", b"b", b"c"], wrong) is None


def test_rows_are_as_long_as_the_values_of_a_transition():
    columns = {c.name: np.zeros((3, *c.shape), c.dtype) for c in make_schema().columns}
    columns["reward"][1] = np.float32("nan")
    rows = rows_of(columns)
    assert {len(row) for row in rows} == {sum(values[0].nbytes for values in columns.values())}
    assert rows[0] == rows[2] != rows[1]
    assert rows_of({name: values[:0] for name, values in columns.items()}) == []


def contents(transitions=0, episodes=0, metrics=0):
    rows, ended, told = ([b"%d" % i for i in range(count)] for count in (transitions, episodes, metrics))
    return LogContents("1", rows, ended, told, {"track.json": b"{}"}, {"seed": "1"})


NOTES = [
    *(Note(float(second), "transitions", 8 * second) for second in range(1, 6)),
    Note(2.5, "episodes", 1),
    Note(3.5, "episodes", 2),
    *(Note(second + 0.25, "metrics", b"%d" % index) for index, second in enumerate((1, 3))),
    Note(5.5, "write"),
]


def test_the_loss_is_the_age_of_the_oldest_that_is_lost():
    found = Kill("at any moment")
    kill._compare(contents(24, 1, 2), contents(80, 9), NOTES, 5.75, found)
    assert found.lost == {"transitions": 16, "episodes": 1, "metrics": 0}
    assert found.lost_s == {"transitions": 1.75, "episodes": 2.25, "metrics": 0.0}
    assert found.faults == []


def test_the_longest_wait_is_that_of_the_first_transition_of_a_chunk():
    writes = [Note(time_s, "write") for time_s in (0.5, 3.5, 3.5, 5.25, 6.0)]  # a head, three chunks, a summary
    chunks = [
        Piece(0, b"", "chunk", "", holds) for holds in ({TRANSITIONS: range(24)}, {}, {TRANSITIONS: range(24, 40)})
    ]
    metadata = Piece(0, b"", "metadata", "", {})
    assert kill.longest_wait([*NOTES[:5], *writes], [metadata, *chunks]) == 3.5 - 1.0


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (contents(16, 1, 2), "transitions made 2.750 s before the kill are lost"),
        (replace(contents(40), rows=[b"0", b"2", *[b"%d" % i for i in range(2, 40)]]), "the 40 recovered transitions"),
        (replace(contents(40), metrics=[b"1"]), "the 1 recovered metrics are not the first ones"),
        (replace(contents(40), attachments={"track.json": b"[]"}), "an attachment is another one"),
        (replace(contents(40), attachments={}), "an attachment is lost"),
        (replace(contents(40), metadata={"seed": "2"}), "the metadata are others"),
    ],
)
def test_a_killed_runs_log_that_is_not_as_it_should_be_is_a_fault(found, words):
    outcome = Kill("at any moment")
    kill._compare(found, contents(80, 9), NOTES, 5.75, outcome)
    assert words in "; ".join(outcome.faults)


def test_mutations_are_counted_by_kind_and_kept_as_json(samples, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(mutations, "train_sample", lambda experiment, seed, frames: samples[seed])
    figures = tmp_path / "figures.json"
    assert mutations.main(["--mutations", "40", "--json", str(figures)]) == 0
    printed = capsys.readouterr().out
    assert "FAULT" not in printed
    assert "A log of 96 transitions" in printed
    [total] = [line.split() for line in printed.splitlines() if line.startswith("all ")]
    assert (total[1], total[-1]) == ("40", "0")
    assert len(json.loads(figures.read_text())["files"]) == 40


def test_a_fault_is_told_and_its_file_is_kept(samples, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(mutations, "train_sample", lambda experiment, seed, frames: samples[seed])
    monkeypatch.setattr(check_module, "verify", lambda path: 1 / 0)
    assert mutations.main(["--mutations", "1", "--keep", str(tmp_path / "kept")]) == 1
    assert "FAULT in file 0, " in capsys.readouterr().out
    kept = {path.name for path in (tmp_path / "kept").iterdir()}
    assert kept == {"damaged-0.mcap", "own.mcap", "other.mcap"}


def test_kills_are_counted_by_moment_and_faults_give_exit_code_1(monkeypatch, capsys, tmp_path):
    loss = {"transitions": 16, "episodes": 1, "metrics": 0}
    ages = {"transitions": 1.75, "episodes": 2.25, "metrics": 0.0}
    results = iter(
        [Kill(kill.ANY_MOMENT, "unfinished", 40, ages, loss, 0.5), Kill(kill.CLOSING, faults=["it is gone"])]
    )
    monkeypatch.setattr(kills, "preload", lambda: None)
    monkeypatch.setattr(
        kills, "run_to_the_end", lambda overrides: kill.Reference(overrides, contents(5), 2.0, 9, 3, 1.5)
    )
    monkeypatch.setattr(kills, "kill_one", lambda reference, moment, draw: next(results))
    assert kills.main(["--kills", "2", "--json", str(tmp_path / "kills.json")]) == 1
    lines = [line.split("  ") for line in capsys.readouterr().out.splitlines()]
    words = {line[0]: [word.strip() for word in line[1:] if word.strip()] for line in lines}
    assert words["at any moment"] == ["1", "0", "1", "0", "0"]
    assert words["in the middle of a write that closes the log"] == ["1", "1", "0", "0", "1"]
    assert words["transitions"] == ["16", "16", "1.75", "1.75"]
    assert ["FAULT in kill 2, in the middle of a write that closes the log: it is gone"] in lines
    assert len(json.loads((tmp_path / "kills.json").read_text())["kills"]) == 2


def test_a_run_that_fails_is_one_sentence(monkeypatch, capsys):
    def fail(overrides):
        raise BenchError(f"`carrl train {' '.join(overrides)}` failed: no such experiment")

    monkeypatch.setattr(kills, "preload", lambda: None)
    monkeypatch.setattr(kills, "run_to_the_end", fail)
    assert kills.main(["--experiment", "none"]) == 1
    assert "scripts/faults kills: `carrl train experiment=none seed=0` failed: no such" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("main", "arguments", "message"),
    [
        (kills.main, ["--kills", "0"], "0 is not above 0"),
        (kills.main, ["--fly"], "unrecognized arguments: --fly"),
        (resumes.main, ["--interval", "0"], "0 is not above 0"),
        (mutations.main, ["--mutations", "many"], "invalid whole number value: 'many'"),
        (mutations.main, ["--json", "nowhere/figures.json"], "'nowhere/figures.json' cannot be written"),
    ],
)
def test_bad_arguments_are_one_sentence_and_exit_code_2(main, arguments, message, capsys):
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    printed = capsys.readouterr()
    assert (ended.value.code, printed.err.count("\n"), printed.out) == (2, 1, "")
    assert message in printed.err


@pytest.mark.parametrize("arguments", [[], ["fly"]])
def test_an_unknown_verb_is_one_usage_line_and_exit_code_2(arguments):
    script = ROOT / "scripts" / "faults"
    if not script.is_file():
        pytest.skip("scripts/ is only in a checkout")
    done = subprocess.run([str(script), *arguments], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert done.stderr.startswith("usage: scripts/faults VERB")


@pytest.mark.slow
def test_real_runs_are_killed_and_recovered():
    tiny = ["compile=false", "track=oval", "env.num_envs=8", "trainer.frames=160", "replay_buffer.batch_size=16"]
    command = [sys.executable, "-m", "benchmarks.log_faults.kills", "--kills", "3", "--run-seeds", "1", *tiny]
    done = subprocess.run(command, cwd=ROOT, env=environment(), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "kill 3 of 3" in done.stderr
    assert "FAULT" not in done.stdout
