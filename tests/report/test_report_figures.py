"""The figures of a report show every group in its colour, and mark what is significant."""

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image

from carrl.render.colours import BLUE, VERMILLION
from carrl.report.comparison_figures import UNDECIDED
from carrl.report.curve_figures import COLOURS, looks, short, wrapped
from carrl.report.document import draw_figures
from carrl.report.findings import find
from carrl.report.runs import Trials
from tests.run_folders import write_evaluations, write_run, write_sweep


def pixels_of(path, colour):
    """How many pixels of the PNG have about this colour."""
    with Image.open(path) as image:
        pixels = np.asarray(image.convert("RGB")).astype(int)
    return int((abs(pixels - np.round(255 * np.array(to_rgb(colour))).astype(int)).max(axis=-1) <= 6).sum())


@pytest.fixture(scope="module")
def figures(tmp_path_factory):
    """Of a loss that laps late and of one that laps early."""
    root = tmp_path_factory.mktemp("runs")
    write_sweep(root, {"dqn": [500, 600, 700, 800, None], "double_dqn": [100, 150, 200, 250, 300]})
    draw_figures(root, find([root]))
    return root


@pytest.mark.parametrize(
    "name", ["evaluation_curves", "learning_curves", "performance_profile", "first_lap", "smoothness"]
)
def test_each_group_has_its_colour_in_every_figure(name, figures):
    path = figures / f"{name}.png"
    with Image.open(path) as image:
        assert image.width == 910
    assert pixels_of(path, BLUE) > 100
    assert pixels_of(path, VERMILLION) > 100


def test_significant_improvements_stand_out(figures, tmp_path):
    write_sweep(tmp_path, {"dqn": [500, 600], "double_dqn": [100, 150]})
    draw_figures(tmp_path, find([tmp_path]))
    in_the_legend = pixels_of(tmp_path / "improvement.png", VERMILLION)
    assert pixels_of(figures / "improvement.png", VERMILLION) > in_the_legend + 50
    assert pixels_of(figures / "improvement.png", UNDECIDED) > 100


def test_many_groups_with_long_names_are_drawn(tmp_path):
    for index in range(9):
        sizes = [index + 1, *[64] * 40]
        write_run(tmp_path / str(index), network={"hidden_sizes": sizes})
        write_run(tmp_path / f"{index}, seed 1", 1, network={"hidden_sizes": sizes})
    drawn = draw_figures(tmp_path, find([tmp_path]))
    assert len(drawn) == 6
    for picture in drawn:
        with Image.open(tmp_path / picture.file) as image:
            image.load()
            assert image.width == 910


def test_evaluations_are_read_as_shares_of_laps_and_speeds_up_to_a_damaged_row(tmp_path):
    header = "frames,lap_completed,lap_reward,mean_speed,drives,laps_completed\n"
    (write_run(tmp_path) / "evaluations.csv").write_text(f"{header}100,False,9,21.5,8,6\n200,True,9,22,8,8\n300,Tr")
    (run,) = find([tmp_path]).runs
    assert run.trials == Trials((100, 200), (0.75, 1.0), (21.5, 22.0), has_speed=True)
    write_evaluations(tmp_path, [(100, False, 7.0), (200, True, 9.0)])
    (run,) = find([tmp_path]).runs
    assert run.trials == Trials((100, 200), (0.0, 1.0), (7.0, 9.0), has_speed=False)


def test_runs_that_were_tried_out_once_have_no_curve_of_evaluations(tmp_path):
    write_evaluations(write_run(tmp_path), [(100, True, 7.0)])
    assert "evaluation_curves.png" not in [picture.file for picture in draw_figures(tmp_path, find([tmp_path]))]


def test_more_groups_than_colours_differ_in_their_lines(tmp_path):
    for index in range(2 * len(COLOURS)):
        write_run(tmp_path / str(index), network={"hidden_sizes": [index + 1]})
    styles = looks(find([tmp_path]).groups).values()
    assert len({(look.colour, look.line) for look in styles}) == 2 * len(COLOURS)


def test_long_names_are_cut_in_the_middle_and_wrapped_with_their_end():
    assert short("abcdefghijklmnop", 9) == "abc...nop"
    assert wrapped("one two three four five six", 9, lines=2) == "one two\n...ve six"
