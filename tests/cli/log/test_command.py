"""`carrl log` as a whole: its help, what it imports, and logs that mean harm."""

import dataclasses
import json
import re
import subprocess
import sys

import pytest

from carrl.cli.main import main
from tests.cli.log.conftest import SCENE, write_log

HOSTILE = "\x1b[31mred\x1b]0;title\x07\x9b2J\u202e\n"
VERBS_ON_A_LOG = (
    ["info"],
    ["ls"],
    ["show", "--all"],
    ["stats"],
    ["cat"],
    ["cat", "--topic", "/episodes"],
    ["cat", "--topic", "/metrics"],
    ["check"],
)


def test_its_help_has_a_line_for_each_verb(capsys):
    with pytest.raises(SystemExit) as caught:
        main(["log", "--help"])
    assert caught.value.code == 0
    printed = capsys.readouterr().out
    verbs = ("info", "ls", "show", "stats", "cat", "check", "recover", "export", "replay")
    assert re.findall(r"^    (\w+) ", printed, re.MULTILINE) == list(verbs)


@pytest.mark.parametrize("verb", ["info", "ls", "show", "stats", "cat", "check", "recover", "export", "replay"])
def test_every_verb_has_help_and_refuses_to_run_without_a_file(capsys, verb):
    with pytest.raises(SystemExit) as caught:
        main(["log", verb, "--help"])
    assert caught.value.code == 0
    assert "a log, such as train.mcap" in capsys.readouterr().out
    assert main(["log", verb]) == 2
    says = f"carrl: the following arguments are required: FILE{', OUT' if verb in ('export', 'recover') else ''}"
    assert capsys.readouterr().err == f"{says}; carrl log {verb} --help tells more\n"


@pytest.mark.parametrize("argv", [["log"], ["log", "nothing"], ["log", "info", "a", "--nothing"]])
def test_wrong_arguments_are_one_sentence_and_exit_code_2(argv, capsys):
    assert main(argv) == 2
    errors = capsys.readouterr().err
    assert errors.endswith("; carrl log --help tells more\n")
    assert errors.count("\n") == 1


@pytest.mark.parametrize("verb", ["info", "ls", "show", "stats", "cat", "check", "replay"])
@pytest.mark.parametrize("content", [b"", b"not a log", None], ids=["empty", "text", "missing"])
def test_what_is_no_log_gives_one_sentence(capsys, tmp_path, verb, content):
    path = tmp_path / "a.mcap"
    if content is not None:
        path.write_bytes(content)
    code = 1 if verb == "check" and content is not None else 2
    assert main(["log", verb, str(path)]) == code
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith(f"carrl: log '{path}': ") and printed.err.count("\n") == 1


def test_no_verb_waits_for_torch_or_matplotlib(log_path, tmp_path):
    outputs = [["export", str(log_path), str(tmp_path / name)] for name in ("a.csv", "a.npz", "a.html")]
    others = [
        ["recover", str(log_path), str(tmp_path / "new.mcap")],
        ["replay", str(log_path), "--no-open", "--output", str(tmp_path / "b.html")],
        ["ls", str(log_path), "--json"],
        ["cat", str(log_path), "--json"],
    ]
    commands = [[verb, str(log_path), *flags] for verb, *flags in VERBS_ON_A_LOG] + outputs + others
    program = f"""
import sys
from carrl.cli.main import main
for command in {commands!r}:
    assert main(["log", *command]) == 0, command
    heavy = {{"torch", "tensordict", "torchrl", "gymnasium", "matplotlib"}} & set(sys.modules)
    assert not heavy, (command, heavy)
"""
    finished = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert finished.returncode == 0, finished.stderr


@pytest.mark.parametrize("command", VERBS_ON_A_LOG, ids=" ".join)
def test_names_in_a_log_cannot_steer_the_terminal(run, hostile_log, command):
    printed = run(command[0], hostile_log, *command[1:])
    assert {character for character in printed if not character.isprintable()} <= {"\n"}


def test_json_has_a_hostile_name_as_it_is_but_escaped(run, hostile_log):
    printed = run("show", hostile_log, "--json")
    assert json.loads(printed)["track_name"] == HOSTILE
    assert "\x1b" not in printed


def test_a_page_of_a_hostile_log_runs_nothing_of_it(run, tmp_path):
    name = '</script><script>document.title="x"</script>'
    page = tmp_path / "a.html"
    run("export", write_log(tmp_path / "train.mcap", (name,)), page)
    assert "</script><script>" not in page.read_text()


@pytest.fixture(scope="module")
def hostile_log(tmp_path_factory):
    """A log whose tracks, actions and terms of the reward are named to do harm."""
    names = {
        "action_names": tuple(f"{HOSTILE}{index}" for index in range(3)),
        "reward_terms": ("collision", HOSTILE, "gate", "steering"),
    }
    scene = dataclasses.replace(SCENE, **names)
    return write_log(tmp_path_factory.mktemp("hostile") / "train.mcap", (HOSTILE, HOSTILE + "2"), scene)
