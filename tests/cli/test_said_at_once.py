"""What a command says before it imports what takes seconds: help, refusals, the first line; and the last lines."""

import json
import os
import subprocess
import sys

import pytest

from carrl.cli.main import VERBS, main
from carrl.cli.text import next_steps
from tests.run_folders import write_run

HEAVY = ("torch", "torchrl", "tensordict", "scipy", "shapely", "matplotlib", "numba", "gymnasium")
HELPS = [[], ["--help"], ["--version"], *([verb, "--help"] for verb in VERBS)]
REFUSALS = [
    "--help evaluate",
    "--version evaluate",
    "evaluate nowhere",
    "evaluate --policy rule --speed-trace nowhere/trace.csv",
    "laps oval lap.csv --out nowhere/laps.mp4",
    "track lap-time oval --csv nowhere/line.csv",
    "track lap-time oval --png nowhere/line.png",
    "evaluate --policy rule --track nowhere.csv",
    "evaluate --policy rule --starts 0",
    "evaluate --policy rule --laps 0",
    "evaluate --policy rule --limit oval=soon",
    "evaluate --polcy rule",
    "drive --track nowhere",
    "drive --run nowhere",
    "drive --vehicle lorry",
    "drive --fps 0",
    "race nowhere --track oval",
    "race nowhere",
    "race nowhere --track nowhere.csv",
    "race nowhere --track oval --laps 0",
    "race nowhere --track oval --pace 0.9",
    "race nowhere --track oval --opponents line --cars 1",
    "watch nowhere",
    "watch nowhere --out lap.avi",
    "evaluate --policy rule --log lap.csv",
    "evaluate --policy rule --video lap.avi",
    "report nowhere",
    "tune",
    "tune --trials 0 experiment=tune",
    "track show nowhere",
    "track check nowhere",
    "track convert nowhere out.csv",
    "track lap-time nowhere",
    "log show nowhere.mcap",
    "train seed=three",
    "train device=gpu",
    "train track=nowhere.csv",
    "train loss=los",
    "train trainer.frames=0",
    "train threads=0",
    "train compile=maybe",
    "train data=log data.path=nowhere.mcap loss=cql",
    "train resume=nowhere",
    "train seed=0 --seed",
]
SCRIPT = f"""
import json, sys
from carrl.cli.main import main
for command in json.load(sys.stdin):
    try:
        code = main(command)
    except SystemExit as end:
        code = end.code
    heavy = [name for name in {HEAVY} if name in sys.modules]
    print("\\nENDED", json.dumps([command, code, heavy]))
"""


@pytest.mark.parametrize(("commands", "code"), [(HELPS, 0), ([line.split() for line in REFUSALS], 2)])
def test_help_and_refusals_do_not_wait_for_torch(commands, code, tmp_path):
    environment = {**os.environ, "PYTHONPATH": os.getcwd()}
    environment.pop("CARRL_TRACKS", None)
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        input=json.dumps(commands),
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=environment,
        timeout=300,
    )
    assert "Traceback" not in done.stderr
    ended = [json.loads(line[6:]) for line in done.stdout.splitlines() if line.startswith("ENDED")]
    assert ended == [[command, code, []] for command in commands]


def test_the_first_line_of_a_training_comes_before_torch(tmp_path):
    script = "import sys; sys.modules['torch'] = None; from carrl.cli.main import main; main(sys.argv[1:])"
    command = [sys.executable, "-c", script, "train", "experiment=smoke", f"hydra.run.dir={tmp_path / 'run'}"]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=300, env={**os.environ, "PYTHONPATH": os.getcwd()}
    )
    assert done.stderr.splitlines()[0] == f"training seed 0 on track oval, in {tmp_path / 'run'}"
    assert "import of torch halted" in done.stderr


def test_the_first_line_of_a_race_comes_before_torch(tmp_path):
    write_run(tmp_path / "run")
    (tmp_path / "run" / "checkpoints").mkdir(exist_ok=True)
    (tmp_path / "run" / "checkpoints" / "best.pt").touch()  # which nobody reads before torch is there
    script = "import sys; sys.modules['torch'] = None; from carrl.cli.main import main; main(sys.argv[1:])"
    asked = ["race", f"{tmp_path / 'run'}", "--track", "oval", "--opponents", "line"]
    command = [sys.executable, "-c", script, *asked]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=300, env={**os.environ, "PYTHONPATH": os.getcwd()}
    )
    first = "racing one run against 5 opponents by line on oval: 10 races of 3 laps on each track"
    assert done.stderr.splitlines()[0] == first
    assert "import of torch halted" in done.stderr


def test_a_finished_run_names_the_next_two_commands(tmp_path, capsys):
    short = ["compile=false", "track=oval", "env.num_envs=8", "trainer.frames=16", "replay_buffer.batch_size=8"]
    run = tmp_path / "a run"
    assert main(["train", *short, f"hydra.run.dir='{run}'"]) == 0
    *_, heading, _, first, _, second = capsys.readouterr().out.splitlines()
    assert heading == "next:"
    assert first.endswith(f"carrl evaluate '{run}' --track paper")
    assert second.endswith(f"carrl log replay '{run}/train.mcap'")


def test_the_next_command_can_be_typed_where_carrl_is_not_on_the_path(monkeypatch, tmp_path):
    monkeypatch.setattr(next_steps.shutil, "which", lambda name: None)
    (tmp_path / ".venv" / "bin").mkdir(parents=True)
    (tmp_path / ".venv" / "bin" / "carrl").touch()
    monkeypatch.setattr(sys, "executable", str(tmp_path / ".venv" / "bin" / "python"))
    monkeypatch.chdir(tmp_path)
    assert next_steps.carrl_command() == ".venv/bin/carrl"


def test_carrl_alone_shows_the_commands_that_matter(capsys):
    assert main([]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("  carrl ")]
    assert [line.split()[1] for line in lines] == ["train", "evaluate", "watch", "report", "track"]
