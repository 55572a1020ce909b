"""`carrl log info` as a person and as a script sees it."""

import json
import subprocess
import sys

import pytest

from carrl.cli.main import main


def test_info_prints_what_is_in_the_file(log_path, capsys):
    assert main(["log", "info", str(log_path)]) == 0
    printed = capsys.readouterr().out
    for words in ("train.mcap", "format version", "transitions", "/transitions", "next_observation", "0.0 to 0.2 s"):
        assert words in printed
    for words in ("config.yaml", "track.json", "oval", "float32", "[7]"):
        assert words in printed


def test_info_as_json_prints_one_document_and_nothing_else(log_path, capsys):
    assert main(["log", "info", "--json", str(log_path)]) == 0
    printed = capsys.readouterr()
    document = json.loads(printed.out)
    assert printed.err == ""
    assert (document["format_version"], document["transitions"], document["time_span_s"]) == (1, 9, 0.2)
    assert document["topics"]["/transitions"]["messages"] == 3
    assert document["columns"]["pose"] == {"dtype": "float32", "shape": [3]}
    assert document["attachments"] == {"config.yaml": 8, "track.json": 16}
    assert document["metadata"]["track"] == "oval"


def test_a_file_that_is_no_log_gives_one_sentence_and_exit_code_2(tmp_path, capsys):
    (tmp_path / "a.mcap").write_bytes(b"not a log")
    assert main(["log", "info", str(tmp_path / "a.mcap")]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("carrl: log '") and printed.err.count("\n") == 1


@pytest.mark.parametrize("argv", [["log"], ["log", "info"], ["log", "nothing"], ["log", "info", "a", "--nothing"]])
def test_wrong_arguments_exit_with_2(argv, capsys):
    with pytest.raises(SystemExit) as caught:
        main(argv)
    assert caught.value.code == 2
    assert "usage: carrl log" in capsys.readouterr().err


def test_looking_into_a_log_imports_no_torch(log_path):
    program = f"""
import sys, carrl.log, carrl.cli.log
carrl.cli.log.main(["info", {str(log_path)!r}])
sys.exit(len({{"torch", "tensordict"}} & set(sys.modules)))
"""
    assert subprocess.run([sys.executable, "-c", program], stdout=subprocess.DEVNULL).returncode == 0
