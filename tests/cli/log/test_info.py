"""`carrl log info` as a person and as a script sees it."""

import json

from carrl.log.codec import tensordict_of
from carrl.log.writer import LogWriter
from tests.cli.log.conftest import SCHEMA, columns_of


def test_it_prints_totals_run_topics_columns_attachments_and_metadata(run, log_path):
    printed = run("info", log_path)
    for words in ("train.mcap", "format version", "transitions", "54", "0.0 to 1.7 s", "/episodes"):
        assert words in printed
    for words in (
        "config.yaml",
        "track.json",
        "square",
        "next_observation",
        "float32",
        "[5]",
        "Q-values: forward, left, right",
    ):
        assert words in printed
    for words in ("carrl 0.1.0", "abc123", "5 rays, -90° to 90°, range 10 m", "forward, left, right"):
        assert words in printed
    assert "lacks" not in printed


def test_what_goes_to_a_pipe_has_each_entry_in_one_line(run, log_path, monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)
    lines = run("info", log_path).splitlines()
    assert any("of the reward: collision, proximity, gate, steering" in line for line in lines)


def test_as_json_it_is_one_document(run, log_path):
    document = json.loads(run("info", log_path, "--json"))
    assert (document["format_version"], document["transitions"], document["episodes_ended"]) == (3, 54, 5)
    assert (document["start_time_s"], document["end_time_s"], document["time_span_s"]) == (0.0, 1.7, 1.7)
    assert document["messages"] == {"/transitions": 18, "/episodes": 5, "/metrics": 3}
    assert document["columns"]["state"] == {
        "dtype": "float32",
        "shape": [3],
        "bits": 32,
        "of": "task",
        "key": "pose",
        "entries": ["x", "y", "heading"],
        "meaning": "before the action",
    }
    assert document["columns"]["epsilon"]["of"] == "algorithm"
    assert document["lacks"] is None
    assert document["attachments"].keys() == {"config.yaml", "track.json"}
    assert (document["part"], document["packages"], document["git_commit"]) == (0, {"carrl": "0.1.0"}, "abc123")
    assert (len(document["sensors"]["angles_rad"]), document["sensors"]["range_m"]) == (5, 10.0)
    assert document["file_bytes"] == log_path.stat().st_size


def test_a_log_that_says_nothing_of_its_run_is_shown_all_the_same(run, tmp_path):
    path = tmp_path / "bare.mcap"
    with LogWriter(path, schema=SCHEMA, attachments={}, metadata={"packages": "[1", "time_step_s": "NaN"}) as writer:
        writer.write(tensordict_of(columns_of(0, 1), SCHEMA))
    assert "bare.mcap" in run("info", path)
    document = json.loads(run("info", path, "--json"))
    assert (document["transitions"], document["sensors"], document["packages"], document["git_commit"]) == (
        3,
        None,
        None,
        None,
    )


def test_a_log_without_transitions_says_so(run, tmp_path):
    path = tmp_path / "empty.mcap"
    LogWriter(path, schema=SCHEMA, attachments={}, metadata={}).close()
    assert "none" in run("info", path)
    assert json.loads(run("info", path, "--json"))["bytes_per_transition"] is None


def test_a_file_that_is_no_log_gives_one_sentence(refused, tmp_path):
    (tmp_path / "a.mcap").write_bytes(b"not a log")
    assert refused("info", tmp_path / "a.mcap").startswith("log '")
