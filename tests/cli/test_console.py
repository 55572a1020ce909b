"""What a run shows on the terminal."""

import pytest

from carrl.cli.main import main
from carrl.cli.text.many_runs import _style_of

SHORT = ["recorder=null", "env.num_envs=8", "trainer.frames=160", "evaluation.interval=80"]
SHORT += ["vehicle.turn_radius=100"]  # so that no car can lap
CIRCUITS = ["track=circuits", "track.count=2", "track.validation=3"]


@pytest.mark.parametrize("seeds", ["null", "[0,1]"])
def test_of_many_circuits_it_says_how_many_are_lapped(seeds, tmp_path, capsys):
    assert main(["train", *SHORT, *CIRCUITS, f"trainer.seeds={seeds}", f"hydra.run.dir={tmp_path}"]) == 0
    output = capsys.readouterr()
    assert "0 of 3 drives" in output.out
    assert "lapped 0 of 3" in output.err


@pytest.mark.parametrize(("seeds", "replicates"), [("null", 1), ("[0,1]", 2)])
def test_of_one_track_it_says_how_far_the_best_drive_came(seeds, replicates, tmp_path, capsys):
    assert main(["train", *SHORT, "track=oval", f"trainer.seeds={seeds}", f"hydra.run.dir={tmp_path}"]) == 0
    output = capsys.readouterr()
    assert "% of a lap" in output.out
    assert f"first lap by 0 of {replicates}" in output.err


@pytest.mark.parametrize(
    ("cells", "name"),
    [
        (["83%", ""], "forward"),
        (["12.5 m/s", ""], "mean speed"),
        (["12.5 m/s", "83%"], "forward or mean speed"),
        ([""], "forward"),
    ],
)
def test_the_column_of_how_cars_drive_is_named_by_what_is_in_it(cells, name):
    assert _style_of(cells) == name
