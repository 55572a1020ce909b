"""What `carrl train`, `evaluate` and `track` say of roads that do not suit the car, and of folders with bad files."""

import json
from pathlib import Path

import pytest
import yaml

from carrl.cli.main import main

TINY = ["env.num_envs=8", "trainer.frames=64", "evaluation.interval=64"]
WARNING = "warning: 1 of 2 tracks do not suit the car; track 'below/tight.yaml': the bend at "


def write_square(path: Path, side: float, radius: float, width: float) -> None:
    corners = [[0, 0], [side, 0], [side, side], [0, side]]
    path.parent.mkdir(exist_ok=True)
    path.write_text(yaml.safe_dump({"corners": corners, "corner_radius": radius, "width": width}))


@pytest.fixture(scope="module")
def circuits(tmp_path_factory) -> Path:
    """Two circuits, one of them too tight and in a folder below, two files that are none, and what does not count."""
    folder = tmp_path_factory.mktemp("circuits")
    write_square(folder / "wide.yaml", 80, 15, 9)
    write_square(folder / "below" / "tight.yaml", 8, 2, 2.1)
    write_square(folder / ".hidden" / "other.yaml", 80, 15, 9)
    (folder / "bad.csv").write_text("# s_m,x_m,y_m\n0,0,0\n")
    (folder / "map.yaml").write_text("image: map.png\nresolution: 0.05\n")
    (folder / "LICENSE").write_text("free")
    return folder


@pytest.fixture(scope="module")
def trained(circuits, tmp_path_factory):
    """The folder of a run on these circuits, and what training printed on standard error."""
    run = tmp_path_factory.mktemp("runs") / "run"
    with pytest.MonkeyPatch.context() as patch:
        lines: list[str] = []
        patch.setattr("carrl.cli.text.console.print", lambda text, file: lines.append(text), raising=False)
        patch.setattr("carrl.tracks.circuits._logger.warning", lambda text, *values: lines.append(text % values))
        folder = ["track=circuits", "track.count=0", "track.validation=1", f"track.folder={circuits}"]
        assert main(["train", *TINY, *folder, f"hydra.run.dir={run}"]) == 0
    return run, lines


def test_training_names_each_bad_file_of_a_folder_and_warns_of_a_road_before_it_begins(trained, circuits):
    _, lines = trained
    assert len(lines) == 3
    assert lines[0].startswith(
        f"left out '{circuits / 'bad.csv'}': track 'bad.csv': the header in line 1 has no column"
    )
    assert lines[1].startswith(f"left out '{circuits / 'map.yaml'}': track 'map.yaml': ")
    assert lines[2].startswith(WARNING.replace("of 2", "of 3"))
    assert lines[2].count("\n") == 0


def test_evaluation_names_each_bad_file_goes_on_with_the_rest_and_warns_once(trained, circuits, capsys):
    run, _ = trained
    capsys.readouterr()
    assert main(["evaluate", str(run), "--track", str(circuits), "--policy", "random", "--json"]) == 0
    output = capsys.readouterr()
    document = json.loads(output.out)
    assert [track["track"] for track in document["tracks"]] == ["below/tight.yaml", "wide.yaml"]
    assert list(document["refused"]) == [str(circuits / "bad.csv"), str(circuits / "map.yaml")]
    first, second, third = output.err.splitlines()
    assert first.startswith("warning: left out '") and "bad.csv" in first
    assert second.startswith("warning: left out '") and "map.yaml" in second
    assert third.startswith(WARNING)


def test_evaluation_on_a_road_that_suits_the_car_warns_of_nothing(trained, circuits, capsys):
    run, _ = trained
    assert main(["evaluate", str(run), "--track", str(circuits / "wide.yaml"), "--policy", "random", "--json"]) == 0
    output = capsys.readouterr()
    assert output.err == ""
    assert "refused" not in json.loads(output.out)


def test_a_folder_without_any_track_is_listed_with_all_reasons(tmp_path, capsys):
    (tmp_path / "a.csv").write_text("")
    (tmp_path / "b.npy").write_bytes(b"none")
    assert main(["track", "list", str(tmp_path)]) == 2
    error = " ".join(capsys.readouterr().err.split())
    assert "2 files that are no tracks" in error
    assert "track 'a.csv': the file is empty" in error
    assert "track 'b.npy': this is not a NumPy array file" in error


def test_list_shows_the_circuits_of_folders_and_names_the_bad_files(circuits, capsys):
    assert main(["track", "list", str(circuits), "--json"]) == 2
    output = capsys.readouterr()
    assert [track["name"] for track in json.loads(output.out)] == ["below/tight.yaml", "wide.yaml"]
    assert [line.split(":")[1] for line in output.err.splitlines()] == [" track 'bad.csv'", " track 'map.yaml'"]


def test_check_takes_a_folder_and_the_car(circuits, capsys):
    assert main(["track", "check", str(circuits), "--json"]) == 2
    documents = json.loads(capsys.readouterr().out)
    assert [Path(document["path"]).name for document in documents] == ["bad.csv", "tight.yaml", "map.yaml", "wide.yaml"]
    assert documents[1]["faults"] == []
    assert documents[1]["warnings"][0].startswith("the bend at ")
    assert documents[3]["warnings"] == []
    tight = str(circuits / "below" / "tight.yaml")
    assert main(["track", "check", tight, "--turn-radius", "7.2"]) == 1
    assert "fault: the bend at " in capsys.readouterr().out
    small = ["--turn-radius", "0.7", "--body-radius", "0.15", "--step-length", "0.1", "--near-wall", "0.2"]
    assert main(["track", "check", tight, *small]) == 0
    output = capsys.readouterr().out
    assert "fault:" not in output and "warning:" not in output


def test_check_prints_small_measures_with_two_digits(tmp_path, capsys):
    write_square(tmp_path / "small.yaml", 10, 1.255, 1.114)
    assert main(["track", "check", str(tmp_path / "small.yaml"), "--body-radius", "0.123"]) == 0
    output = capsys.readouterr().out
    assert "1.11 m" in output and "0.12 m" in output and "warning: for the default car, " in output
    assert "1.2" in next(line for line in output.splitlines() if "least radius, left" in line)


@pytest.mark.parametrize("flag", ["--turn-radius", "--step-length", "--near-wall", "--body-radius"])
def test_a_measure_of_the_car_that_is_none_is_refused(flag, capsys):
    assert main(["track", "check", "paper", flag, "0"]) == 2
    assert capsys.readouterr().err == f"carrl: {flag} is 0.0; it must be a positive number of metres\n"
