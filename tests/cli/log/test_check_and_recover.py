"""`carrl log check` and `carrl log recover`: exit codes, sentences, JSON."""

import json

import pytest

import carrl.log
from carrl.cli.main import main
from tests.cli.log.conftest import write_log
from tests.log.rewriting import rewrite


@pytest.fixture
def cut_log(log_path, tmp_path):
    """The log without its last 3,000 bytes, as after a power cut."""
    path = tmp_path / "cut.mcap"
    path.write_bytes(log_path.read_bytes()[:-3_000])
    return path


@pytest.fixture
def flipped_log(log_path, tmp_path):
    """The log with one bit of its second half turned over."""
    content = bytearray(log_path.read_bytes())
    content[len(content) // 2] ^= 1
    path = tmp_path / "flipped.mcap"
    path.write_bytes(content)
    return path


def test_an_intact_log_is_said_to_be_intact(run, log_path):
    assert run("check", log_path) == "intact: 54 transitions, 5 ended episodes, 3 messages of metrics\n"
    assert json.loads(run("check", log_path, "--json")) == {
        "path": str(log_path),
        "intact": True,
        "transitions": 54,
        "episodes": 5,
        "metrics": 3,
    }


@pytest.mark.parametrize("damaged", ["cut_log", "flipped_log"])
def test_a_damaged_log_gives_one_sentence_and_exit_code_1(capsys, damaged, request):
    path = request.getfixturevalue(damaged)
    assert main(["log", "check", str(path)]) == 1
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith(f"carrl: log '{path}': is ") and printed.err.count("\n") == 1
    assert "carrl log recover IN OUT" in printed.err


def test_a_damaged_log_is_told_in_json_as_well(capsys, cut_log):
    assert main(["log", "check", str(cut_log), "--json"]) == 1
    printed = capsys.readouterr()
    document = json.loads(printed.out)
    assert (document["path"], document["intact"]) == (str(cut_log), False)
    assert printed.err == f"carrl: {document['error']}\n"


def test_what_cannot_be_read_gives_exit_code_2(refused, tmp_path):
    assert "cannot be read: No such file" in refused("check", tmp_path / "nothing.mcap")
    assert "is a folder" in refused("check", tmp_path, "--json")


def test_of_an_intact_log_nothing_is_lost(run, log_path, tmp_path):
    path = tmp_path / "new.mcap"
    first, second = run("recover", log_path, path).splitlines()
    assert first == (
        f"{path}: salvaged 54 transitions, 5 ended episodes, 3 messages of metrics, with config.yaml and track.json."
    )
    assert second == "Nothing is known to be lost: the log was finished, and every part of it is there."
    assert carrl.log.read_episodes(path) == carrl.log.read_episodes(log_path)


def test_of_a_log_that_was_cut_off_the_rest_is_salvaged_and_the_loss_is_told(run, cut_log, tmp_path):
    path = tmp_path / "new.mcap"
    lines = run("recover", cut_log, path).splitlines()
    assert lines[0].startswith(f"{path}: salvaged ")
    assert "The log was not finished: what came after its last intact part is lost, and nobody knows how much." in lines
    assert main(["log", "check", str(path)]) == 0


def test_what_was_salvaged_is_told_in_json(run, cut_log, tmp_path):
    path = tmp_path / "new.mcap"
    document = json.loads(run("recover", cut_log, path, "--json"))
    assert (document["path"], document["complete"], document["finished"]) == (str(path), False, False)
    assert document["transitions"] == carrl.log.verify(path).transitions
    assert document["attachments"] == ["config.yaml", "track.json"]
    assert document["attachments_lost"] == []


def test_each_kind_of_loss_has_its_sentence(run, log_path, tmp_path, monkeypatch):
    loss = carrl.log.Recovery(
        True,
        9,
        2,
        1,
        1_200,
        3,
        True,
        ("config.yaml",),
        ("track.json",),
        2,
        4,
        20,
        5,
        ("0a", "0b"),
        ("topic '/notes'",),
        ("/transitions", "/metrics"),
        1_500,
        7,
    )
    monkeypatch.setattr("carrl.cli.log.integrity.recover", lambda source, target, run: loss)
    assert run("recover", log_path, "new.mcap").splitlines() == [
        "new.mcap: salvaged 9 transitions, 2 ended episodes, 1 message of metrics, with config.yaml.",
        "Lost: topic /transitions, which every log has; the ended episodes have 1,500 steps, whose transitions are not "
        "there.",
        "Lost: topic /metrics, which every log has.",
        "Lost: 1,200 transitions before or between those salvaged.",
        "Lost: 3 ended episodes before or between those salvaged.",
        "Lost: 2 chunks that the log's index tells of.",
        "Lost: 4 messages that the log's statistics count.",
        "Lost: the metadata, what the log said of its run; show, replay and pictures need it.",
        "Lost: track.json.",
        "Not verified: 5 messages, for which no checksum vouches.",
        "Left out: 7 duplicate messages.",
        "Left out: 20 transitions that do not follow those salvaged.",
        "Left out: all of the runs 0a, 0b; salvage another run with --run RUN.",
        "Left out, for it is not part of a log: topic '/notes'.",
    ]


def test_a_file_that_is_there_already_is_left_alone(refused, log_path, tmp_path):
    path = tmp_path / "precious.mcap"
    path.write_text("precious")
    assert "is there already" in refused("recover", log_path, path)
    assert path.read_text() == "precious"


def test_nothing_of_a_log_gives_nothing(refused, tmp_path):
    (tmp_path / "a.mcap").write_text("not a log")
    assert "holds nothing of a CarRL log" in refused("recover", tmp_path / "a.mcap", tmp_path / "b.mcap", "--json")
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]


def test_of_two_logs_in_one_file_each_is_recovered_by_the_name_of_its_run(capsys, run, log_path, tmp_path):
    other = write_log(tmp_path / "other.mcap")
    merged = rewrite(log_path, tmp_path / "merged.mcap", other)
    for verb in ("check", "ls", "info"):
        assert main(["log", verb, str(merged)]) == 2
        assert "holds 2 logs merged into one file" in capsys.readouterr().err
    for number, path in enumerate((log_path, other)):
        name = carrl.log.read_metadata(path)["run"]
        lines = run("recover", merged, tmp_path / f"{number}.mcap", "--run", name).splitlines()
        assert "salvaged 54 transitions, 5 ended episodes, 3 messages of metrics" in lines[0]
        assert lines[1].startswith("Left out: all of run ")
        assert carrl.log.read_metadata(tmp_path / f"{number}.mcap")["run"] == name
