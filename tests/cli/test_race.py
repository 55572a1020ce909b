"""`carrl race`: runs against each other, and against opponents."""

import json
import shutil

import pytest

from carrl.cli.main import main
from carrl.log.reader import Log
from tests.export.untrained_runs import write_untrained_run

SHORT = ["--track", "oval", "--laps", "1", "--races", "2"]
"""The networks have random weights, so that nobody gets far."""


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A run that sees rays, one that sees more with other rays, and one of two seeds."""
    root = tmp_path_factory.mktemp("race")
    write_untrained_run(root / "plain")
    write_untrained_run(root / "other", "observation=traffic", "sensor.rays=5", seed=1)
    for seed in (3, 4):
        write_untrained_run(root / "seeds" / f"seed={seed}", seed=seed)
    return root


def raced(capsys, *words):
    assert main(["race", *map(str, words), *SHORT, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_runs_race_each_other_each_with_its_own_sensors(runs, capsys):
    words = runs / "plain", runs / "other", runs / "plain"
    document = raced(capsys, *words)
    assert list(document["runs"]) == ["plain", "other", "plain (2)"]
    assert [len(race["cars"]) for race in document["races"]] == [3, 3]
    starts = [{row["car"]: row["start"] for row in race["cars"]} for race in document["races"]]
    assert starts == [{"plain": 1, "other": 2, "plain (2)": 3}, {"plain": 2, "other": 3, "plain (2)": 1}]
    assert {row["car"] for row in document["league"]} == set(document["runs"])
    assert sum(row["elo"] for row in document["league"]) == pytest.approx(3000, abs=0.2)
    assert document["elo"] == {"start": 1000.0, "k": 16.0}
    assert raced(capsys, *words) == document


def test_each_seed_races_opponents_by_itself(runs, capsys):
    among = "--opponents", "line", "--cars", "3", "--pace", "0.9"
    together = raced(capsys, runs / "seeds", *among)
    assert [each["car"] for each in together["runs"]] == ["seed=3", "seed=4"]
    assert (together["opponents"], together["pace"], together["cars"]) == ("line", 0.9, 3)
    for each in together["runs"]:
        assert [[row["car"] for row in race["cars"]][-1] for race in each["races"]] == [each["car"]] * 2
        assert {row["start"] for race in each["races"] for row in race["cars"] if row["car"] == each["car"]} == {3}
        (own,) = (row for row in each["league"] if row["car"] == each["car"])
        assert {"wins", "mean_place", "places_won", "contacts_own_per_km", "intervals"} <= own.keys()
    alone = raced(capsys, runs / "seeds" / "seed=4", *among)
    assert alone["runs"][0] == together["runs"][1]


def test_the_tables_fit_80_columns(runs, capsys):
    assert main(["race", str(runs / "seeds"), *SHORT, "--opponents", "rule", "--cars", "2"]) == 0
    printed = capsys.readouterr().out
    assert max(map(len, printed.splitlines())) <= 80
    assert "1 lap of oval against 1 of rule" in printed
    assert main(["race", str(runs / "plain"), str(runs / "other"), *SHORT]) == 0
    printed = capsys.readouterr().out
    assert max(map(len, printed.splitlines())) <= 80
    cells = [line.split("│")[1:3] for line in printed.splitlines() if line.startswith("│ ") and " oval" in line]
    assert len(cells) == 4


def test_a_log_has_an_episode_for_each_race_with_the_others_beside(runs, tmp_path, capsys):
    for name, words in {
        "together": [runs / "plain", runs / "other"],
        "among": [runs / "plain", "--opponents", "line", "--cars", "2"],
    }.items():
        path = tmp_path / f"{name}.mcap"
        document = raced(capsys, *words, "--log", path)
        assert raced(capsys, *words) == document  # what keeps a race does not change it
        assert main(["log", "check", str(path)]) == 0
        with Log(path) as log:
            episodes = list(log.episodes())
            assert [each.episode for each in sorted(episodes, key=lambda each: each.episode)] == [0, 1]
            assert {each.ended for each in episodes} <= {"collision", "other end"}
        capsys.readouterr()
        assert main(["log", "show", str(path), "--episode", "0", "--json"]) == 0
        capsys.readouterr()
        assert main(["log", "replay", str(path), "--episode", "0", "--no-open", "--output", f"{path}.html"]) == 0
        capsys.readouterr()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["plain"], "'plain' has nobody to race; name several runs, or add --opponents line"),
        (["plain", "plain", "--pace", "0.5"], "--pace has no effect without --opponents; add that, or leave it out"),
        (["plain", "--opponents", "line", "--pace", "2"], "pace is 2.0; it must be a share between 0.01 and 1"),
        (["plain", "--opponents", "line", "--cars", "1"], "cars is 1; it must be a whole number, at least 2"),
        (["plain", "--opponents", "mine"], "argument --opponents: invalid choice: 'mine'"),
        (["plain", "nowhere"], "run 'nowhere' is not a folder"),
        (["plain", "plain", "--races", "0"], "races is 0; it must be a whole number, at least 1"),
        (["plain", "plain", "--log", "race.csv"], "'race.csv' is no name of a log; it must end in .mcap"),
        (["seeds", "--opponents", "line", "--log", "race.mcap"], "--log keeps the races of one run, and here are 2"),
        (["plain", "begun"], "is not there yet; a run in progress has it from its first evaluation on"),
        (["plain", "faster"], "cars that race must be the same; that of plain is Vehicle(speed=10.0"),
    ],
)
def test_races_that_cannot_be_are_refused_in_one_sentence(runs, tmp_path, monkeypatch, capsys, words, message):
    monkeypatch.chdir(tmp_path)
    for name in ("plain", "seeds"):
        shutil.copytree(runs / name, name)
    shutil.copytree("plain", "begun")
    (tmp_path / "begun" / "checkpoints" / "best.pt").unlink()
    if "faster" in words:
        write_untrained_run(tmp_path / "faster", "vehicle.speed=12.0")
    assert main(["race", *words, "--track", "oval"]) == 2
    *announced, error = capsys.readouterr().err.splitlines()
    assert message in error
    assert all(line.startswith("racing ") for line in announced)
