"""Every `carrl` command and Python program of the README and of docs/ runs as it stands there, long ones scaled down.

A command keeps its verb, flags, groups and keys. What it names is put in place (`outputs/DATE/TIME` is a small run,
`FILE.csv` a track), and how long it takes is cut: frames, cars, replicates, circuits, trials.
"""

import re
import shlex
import shutil
import sys
from pathlib import Path

import pytest

from carrl.cli.main import main
from carrl.tracks.track import Track
from tests.driven_laps import steady, write_trace

PAGES = [Path("README.md"), Path("CONTRIBUTING.md"), *sorted(Path("docs").rglob("*.md"))]
OWN_PARTS = Path("examples/own_parts").resolve()
(DRAWING,) = re.findall(r"^```yaml\n(.*?)^```", Path("docs/own-car-and-track.md").read_text(), re.M | re.S)
BLOCK = re.compile(r"^```(?:console|sh|bash)\n(.*?)^```", re.M | re.S)
SHORT = {
    "trainer.frames": "32",
    "evaluation.interval": "32",
    "env.num_envs": "8",
    "env.max_steps": "3",
    "replay_buffer.capacity": "512",
    "replay_buffer.batch_size": "8",
}
SHORT_FROM_LOG = {"data.updates": "4", "replay_buffer.batch_size": "16"}
FEW_CIRCUITS = {"track.count": "2", "track.validation": "1"}
ELSEWHERE = {
    "collector=ray": "needs a cluster: tests/data/test_ray_collector.py",
    "hydra/launcher=": "needs processes or SLURM: tests/cli/test_sweep.py",
    "logger=wandb": "needs a package: tests/train/test_scalars.py",
    "logger=mlflow": "needs a package: tests/train/test_scalars.py",
    "carrl watch": "opens a window: tests/cli/test_watch.py",
    "carrl drive": "opens a window: tests/cli/test_drive.py",
    "--policy line": "looks for two minimum laps: tests/evaluation/test_line_driver.py",
    r"lap-time (?!.*--quick)": "takes a minute: tests/cli/test_track_lap_time.py",
    r"aalborg\.xml": "needs TORCS: tests/tracks/test_torcs.py",
    r"\.geojson": "needs a file from elsewhere: tests/tracks/test_geojson.py",
    r"\| source": "needs fish: tests/cli/test_completion.py",
    "--rerun": "opens a viewer: tests/export/test_rerun_recording.py",
}
"""What is not tried here, and where it is."""
CUT = re.compile(r"outputs/[^\s\],]+|(?<=seeds=)\S+|(?<=trainer.frames=)\S+|(?<=--trials )\S+|(?<=--bin-size )\S+")
"""What commands may differ in and still be the same one once it is put in place and cut."""
PROGRAMS_ELSEWHERE = {
    "deploy.md": "needs an exported policy: tests/export/test_deploy_page.py",
    "own-parts.md": "quotes the example: tests/test_own_parts_example.py",
}
NEEDED = {"skrl.md": "skrl"}
"""Of pages whose programs need a package that is no extra: its name."""
SHORTER = {
    'loss="double_dqn")': 'loss="double_dqn", overrides=SHORT)',
    "model.learn(4_096)": "model.learn(2_048)",
    "model.learn(2_000)": "model.learn(600)",
    "range(60)": "range(1)",
    '"timesteps": 1_500': '"timesteps": 40',
    "LazyMemmapStorage(10_000_000)": "LazyMemmapStorage(1_000)",
    "episodes=[42]": "episodes=[0]",
}
"""What is put in place of what in programs, so that they take seconds."""


def documented():
    """The commands that are distinct when they run here, each with the page that it is on first."""
    found = {}
    for page in PAGES:
        for block in BLOCK.findall(page.read_text()):
            for line in block.replace("\\\n", "").splitlines():
                for command in re.sub(r"\$\(ls .*\)", "--track FILE.csv", line.removeprefix("$ ")).split(" && "):
                    words = shlex.split(command, comments=True)
                    if words[:1] in (["carrl"], ["scripts/train"]):
                        found.setdefault(CUT.sub("", " ".join(words)), (page, words))
    return [pytest.param(words, id=f"{page.name}: {' '.join(words)}") for page, words in found.values()]


COMMANDS = documented()


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder with a sweep of two runs and a track."""
    folder = tmp_path_factory.mktemp("documented")
    values = [f"{key}={value}" for key, value in (SHORT | {"evaluation.interval": "16"}).items()]
    for loss in ("dqn", "double_dqn"):
        path = folder / "sweep" / f"loss={loss}"
        assert main(["train", "track=oval", *values, f"loss={loss}", f"hydra.run.dir={path}"]) == 0
    assert main(["track", "random", "--seed", "1", "--out", str(folder / "track.csv")]) == 0
    assert main(["track", "convert", str(folder / "track.csv"), str(folder / "map.png")]) == 0
    return folder


@pytest.fixture
def workplace(made, tmp_path, monkeypatch):
    """A working directory in which the files that commands name are found."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    sys.modules.pop("own_parts", None)
    monkeypatch.setenv("CARRL_TRACKS", str(tmp_path / "library"))
    monkeypatch.setenv("CXX", "no-such-compiler")  # updates without machine code of their own are eager
    folders = ("FOLDER", "mine", "tight12", "hard", "library")
    for name in ("FILE.csv", "with, comma.csv", "my_track.csv", *(f"{folder}/Monza.csv" for folder in folders)):
        Path(name).parent.mkdir(exist_ok=True)
        shutil.copy(made / "track.csv", name)
    for name in ("Monza.csv", "Norisring.csv", "mine/a.csv"):
        shutil.copy("FILE.csv", name)
    for name in ("lab.yaml", "my_track.yaml"):
        Path(name).write_text(DRAWING)
    Path("MAPS").mkdir()
    for name in ("aut", "esp", "gbr", "mco"):
        shutil.copy(made / "map.yaml", f"MAPS/{name}.yaml")
    shutil.copy(made / "map.png", "MAPS")
    shutil.copytree(OWN_PARTS / "conf", "conf")
    shutil.copy(OWN_PARTS / "own_parts.py", ".")
    for name, speed in (("today.csv", 400.0), ("yesterday.csv", 300.0), ("limit.csv", 500.0), ("policy.csv", 350.0)):
        track = Track.load("FILE.csv")
        write_trace(tmp_path / name, track, steady(track, speed, step=0.01))
    for name in ("map.yaml", "map.png"):
        shutil.copy(made / name, name)
    for folder in ("acute", "docs/images"):
        Path(folder).mkdir(parents=True)
    for name in ("A", "B", "RUN", "to-go-on"):
        shutil.copytree(made / "sweep/loss=dqn", name)
    shutil.copytree(made / "sweep/loss=double_dqn", "C")
    shutil.copy("RUN/train.mcap", "train.mcap")
    return tmp_path


def in_place(word, made):
    """The word with what stands for a run, a sweep, a log, a track or a folder replaced by one that is there."""
    run = made / "sweep/loss=dqn"
    key, is_flag, value = word.partition("=") if re.match(r"[a-z_./]+=", word) else ("", "", word)
    if key == "resume":
        return "resume=to-go-on"
    if key == "grand_prix":
        return f"oval={value}"
    if key in ("hydra.run.dir", "hydra.sweep.dir"):
        return word
    value = value.replace("$LOG", "train.mcap").replace("../shared/tracks/real", "FOLDER").replace("$loss", "cql")
    value = re.sub(r"outputs/[^]\[]*train\.mcap|recovered.mcap$", "train.mcap", value)
    value = re.sub(r"^outputs/(multirun/\S+|recipes|losses)$", str(made / "sweep"), value)
    value = re.sub(r"^outputs/\S+$", str(run), value)
    value = re.sub(r"^RUN/seed=0$", "RUN", value)
    value = "FILE.csv" if value in ("FILE", "grand_prix") else value
    return f"{key}{is_flag}{value}"


def scaled(words):
    """The words of `carrl train` with so few frames, cars, seeds and circuits that they take a second."""
    words = [re.sub(r"(seeds=\[\d+)\.\.\d+\]", r"\1]", word) for word in words]
    words = [re.sub(r"seed=range\(\d+,\d+\)", "seed=range(0,2)", word) for word in words]
    short = dict(SHORT_FROM_LOG if "data=log" in words else SHORT)
    if any(word in ("experiment=generalist", "experiment=racer", "track=circuits") for word in words):
        short |= FEW_CIRCUITS
    if any(word.startswith("resume=") for word in words):
        short = {"trainer.frames": "64"}
    words = [word for word in words if word.partition("=")[0] not in short]
    return [*words, *(f"{key}={value}" for key, value in short.items())]


def short(words):
    """The same for the other verbs."""
    flags = {"--trials": "2", "--count": "1", "--starts": "2", "--races": "2", "--bin-size": "0.7", "--episode": "0"}
    words = [flags.get(before, word) for before, word in zip(["", *words], words, strict=False)]
    if words[0] == "tune":
        return [*words, *(f"{key}={value}" for key, value in SHORT.items() if key == "trainer.frames")]
    return words


@pytest.mark.parametrize("words", COMMANDS)
def test_a_documented_command_runs(words, workplace, made, capsys):
    command = " ".join(words)
    for part, reason in ELSEWHERE.items():
        if re.search(part, command):
            pytest.skip(reason)
    is_output = [before in ("--out", "--folder") for before in ["", *words]]
    words = [
        word if out else in_place(word, made) for word, out in zip(words, is_output, strict=False) if word != "..."
    ]
    if words[1:3] == ["log", "recover"]:
        words[4] = "another.mcap"
    arguments = ["train", *scaled(words[1:])] if words[0] == "scripts/train" else words[1:]
    arguments = ["train", *scaled(arguments[1:])] if arguments[0] == "train" else short(arguments)
    code = main(arguments)
    assert code == 0, capsys.readouterr().err


def programs():
    """The Python of each page that has some: programs in which one goes on from the one before it."""
    for page in PAGES:
        blocks = re.findall(r"^```python\n(.*?)^```", page.read_text(), re.M | re.S)
        if blocks and page.name not in PROGRAMS_ELSEWHERE:
            yield pytest.param(page.name, blocks, id=page.name)


@pytest.mark.parametrize(("page", "blocks"), list(programs()))
def test_the_python_of_a_page_runs(page, blocks, workplace, monkeypatch):
    if page in NEEDED:
        pytest.importorskip(NEEDED[page], reason=f"{NEEDED[page]} is not installed; pip install {NEEDED[page]}")
    monkeypatch.setenv("XDG_CACHE_HOME", str(workplace / "cache"))
    for name in ("outputs/fast", "seed=0", "seed=1"):
        shutil.copytree("RUN", name)
    code = "\n".join(blocks)
    for long, short in SHORTER.items():
        code = code.replace(long, short)
    names = {"SHORT": [f"{key}={value}" for key, value in SHORT.items()]}
    exec(code, names)
    if "action = run.policy" in code:
        assert names["action"] in (0, 1, 2)
        assert len(names["transitions"]) == int(SHORT["trainer.frames"])


@pytest.mark.parametrize("long", SHORTER)
def test_what_is_made_shorter_stands_in_a_page(long):
    assert any(long in page.read_text() for page in PAGES)


def test_commands_are_found_in_the_pages():
    assert {"train", "evaluate", "log", "track", "report", "tune"} <= {words.values[0][1] for words in COMMANDS}


@pytest.mark.parametrize("page", [*PAGES, Path("CHANGELOG.md"), Path("SECURITY.md")], ids=str)
def test_what_a_page_names_is_there(page):
    text = page.read_text()
    links = {page.parent / link for link in re.findall(r"\]\(([^)#:\s]+)[^):]*\)", text)}
    files = {Path(name) for name in re.findall(r"`((?:carrl|conf|tests|scripts|examples|benchmarks)/[\w/.]+)`", text)}
    modules = {Path(*name.split(".")) for name in re.findall(r"`(carrl(?:\.[a-z_0-9]+)+)`", text)}
    missing = [str(path) for path in links | files if not path.exists()]
    missing += [
        str(path)
        for path in modules
        if not any(
            each.exists() for each in (path, path.with_suffix(".py"), path.parent, path.parent.with_suffix(".py"))
        )
    ]
    assert not missing
