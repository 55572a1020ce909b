"""What `carrl log show` prints is read as text: the figures are the log's, and the map is where the car was."""

import io
import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import plotext
import pytest
from rich.console import Console

from carrl.cli.text.episode_text import print_episode, ray_bars
from carrl.log.trace import EpisodeTrace
from carrl.render import round_ticks
from carrl.render.terminal import Chart, Ink, action_inks, map_chart


def printed(trace, width=80, height=24, colours=False, rows=None):
    file = io.StringIO()
    console = Console(
        file=file, width=width, height=height, force_terminal=colours, color_system="truecolor" if colours else None
    )
    print_episode(trace, console, rows)
    return file.getvalue()


def table_of(text):
    """Cells of the rows whose first cell is a step, by its number."""
    lines = text[text.index("step  ") :].splitlines()[2:]
    rows = [re.split(r"\s{1,}", line.strip()) for line in lines]
    return {int(cells[0]): cells[1:] for cells in rows if cells[0].isdigit()}


def repeated(trace, times):
    """The steps of the trace again and again, numbered on."""
    columns = {name: np.concatenate([values] * times) for name, values in trace.columns.items()}
    columns["step"] = np.arange(len(columns["step"]))
    passed = columns["next_gates_passed"] - columns["gates_passed"]
    columns |= {"gates_passed": passed.cumsum() - passed, "next_gates_passed": passed.cumsum()}
    return EpisodeTrace(trace.scene, columns)


def test_the_first_line_says_what_became_of_the_episode(trace):
    first = printed(trace, width=120).splitlines()[0]
    total = f"{trace.rewards.sum():,.4g}"
    assert first == f"episode 7 · car 2 on square · 14 steps in 1.4 s · return {total} · 1 gate · collision"


def test_laps_are_counted_from_the_gates(trace):
    assert "9 gates, 2 laps" in printed(repeated(trace, 9), width=120)


def test_other_cars_stand_on_the_map_where_they_were_at_the_end(trace, among_others):
    text, alone = printed(among_others), printed(trace)
    assert "o another car at the end" in text
    assert "another car" not in alone
    begin, end = text.index("\n\n") + 2, text.index("S start")
    drawing = text[begin:end].splitlines()
    places = [(row, line.index("o")) for row, line in enumerate(drawing) if "o" in line]
    walls = [(row, column) for row, line in enumerate(drawing) for column, sign in enumerate(line) if sign == "·"]
    (top, left), (bottom, right) = np.min(walls, axis=0), np.max(walls, axis=0)
    found = [((column - left) / (right - left), (bottom - row) / (bottom - top)) for row, column in places]
    np.testing.assert_allclose(found, among_others.others[-1, ::-1, :2] / 20, atol=0.06)


def test_every_step_of_a_short_episode_has_its_row(trace):
    rows = table_of(printed(trace))
    assert list(rows) == list(range(14))
    assert rows[3][0] == "0.3"
    actions = [re.search(r"[▁▂▃▄▅▆▇█] (\w+)", " ".join(cells))[1] for cells in rows.values()]
    assert [trace.scene.action_names.index(action) for action in actions] == trace.actions.tolist()


def test_a_star_marks_the_actions_that_were_drawn_at_random(trace):
    text = printed(trace)
    assert [step for step, cells in table_of(text).items() if any(cell.endswith("*") for cell in cells)] == [6]
    assert "* drawn at random" in text
    greedy = EpisodeTrace(trace.scene, {**trace.columns, "exploratory": np.zeros(14, dtype=bool)})
    assert "*" not in printed(greedy)


def test_the_reward_comes_with_what_it_was_for(trace):
    rows = table_of(printed(trace))
    gate = int(np.flatnonzero(np.diff(trace.gates_passed))[0])
    assert rows[gate][-2:] == ["+50", "gate"]
    assert rows[0][-1] == "0"


def test_several_terms_of_one_reward_come_with_their_values_where_lines_are_long(trace):
    assert re.search(r"^ *13 .* -220 +collision -200, proximity -20 ", printed(trace, width=140), re.MULTILINE)
    *_, last_row, its_rest, _ = printed(trace).splitlines()
    assert re.search(r"^ *13 .* -220 +collision, *$", last_row)
    assert its_rest.strip() == "proximity"


def test_the_nearest_wall_comes_with_its_distance_and_direction(trace):
    first = next(line for line in printed(trace).splitlines() if line.startswith("   0 "))
    assert trace.ranges[0].tolist() == pytest.approx([3, 3 * 2**0.5, 10, 3 * 2**0.5, 3])
    assert " 3.0 m 90° right " in first
    assert " ▃▄█▄▃ " in first


def test_ray_bars_go_from_left_to_right_while_the_readings_go_from_right_to_left():
    assert ray_bars(np.array([0.0, 0.2, 0.5, 0.99, 1.0])) == "██▅▂▁"


def test_a_long_episode_shows_its_first_and_last_steps_unless_asked_for_others(trace):
    long = repeated(trace, 5)
    assert list(table_of(printed(long))) == [*range(5), *range(55, 70)]
    assert "⋮" in printed(long)
    assert list(table_of(printed(long, rows=range(70)))) == list(range(70))
    assert list(table_of(printed(long, rows=range(20, 23)))) == [20, 21, 22]


def test_a_gap_in_the_record_shows_in_the_table_and_breaks_the_line(trace):
    kept = [0, 1, 9, 10]
    text = printed(EpisodeTrace(trace.scene, {name: values[kept] for name, values in trace.columns.items()}))
    assert list(table_of(text)) == kept


def test_the_map_has_the_drive_from_its_start_to_the_collision(trace):
    lines = printed(trace).splitlines()
    legend = next(index for index, line in enumerate(lines) if line.startswith("S start"))
    assert lines[legend].split("  ") == ["S start", "f forward", "l left", "r right", "X collision"]
    drawing = lines[2:legend]
    starts, ends = ([(row, line.index(mark)) for row, line in enumerate(drawing) if mark in line] for mark in "SX")
    assert len(starts) == len(ends) == 1
    width, height = max(map(len, map(str.rstrip, drawing))), len(drawing)
    for (row, column), position in ((starts[0], trace.poses[0]), (ends[0], trace.poses[-1])):
        assert column / width == pytest.approx(position[0] / 20, abs=0.05)
        assert 1 - row / height == pytest.approx(position[1] / 20, abs=0.1)


def test_a_map_is_not_distorted(track_shape):
    lines = map_chart(track_shape, 100, 20, Ink("·")).text().plain.splitlines()
    assert len(lines) == 20
    assert max(map(len, map(str.rstrip, lines))) == pytest.approx(40, abs=1)


@pytest.mark.parametrize("width", [40, 80, 119, 120, 200])
def test_nothing_is_wider_than_the_console(trace, width):
    assert max(map(len, printed(repeated(trace, 30), width=width).splitlines())) <= width


def test_without_colours_there_is_not_one_control_code(trace):
    assert "\x1b" not in printed(trace)
    assert "\x1b[38;2;213;94;0m" in printed(trace, colours=True)


def test_a_console_told_to_have_no_colours_gets_letters(trace):
    file = io.StringIO()
    print_episode(trace, Console(file=file, width=80, force_terminal=True, color_system="truecolor", no_color=True))
    assert "f forward" in file.getvalue()


def test_the_same_episode_prints_the_same_again_and_leaves_plotext_as_it_was(trace):
    def of_everyone():
        return plotext.terminal.size(), plotext.figure.build().string(True)

    before = of_everyone()
    first = printed(trace, width=160)
    assert printed(trace, width=80) != first
    assert printed(trace, width=160) == first
    assert of_everyone() == before


def test_actions_of_the_same_first_letter_get_different_letters():
    inks = action_inks(["left", "lift", "right", "l"], coloured=False)
    assert [ink.symbol for ink in inks] == ["l", "i", "r", "0"]


def test_every_line_of_a_chart_is_there_to_be_seen():
    text = Chart(40, 10, "a title").axes((0, 10), (-5, 5)).line([0, 10], [-5, 5], Ink("x")).text().plain
    assert "a title" in text
    assert text.count("x") > 20
    assert len(text.splitlines()) == 10


def test_ticks_are_round_and_within_bounds():
    assert round_ticks(-220, 400, 5) == [-200, 0, 200, 400]
    assert round_ticks(0.1, 0.32, 4) == pytest.approx([0.1, 0.2, 0.3])


def test_an_episode_of_one_step_is_printed(trace):
    one = EpisodeTrace(trace.scene, {name: values[:1] for name, values in trace.columns.items()})
    assert "the record ends" in printed(one)


def test_q_values_that_went_out_of_bounds_are_printed_and_the_others_drawn(trace):
    values = trace.columns["action_value"].copy()
    values[2], values[3, 0] = np.nan, np.inf
    values[4] = 1e30
    for shown in (values, np.full_like(values, np.nan)):
        text = printed(EpisodeTrace(trace.scene, {**trace.columns, "action_value": shown}))
        assert "nan" in text
    assert list(table_of(text)) == list(range(14))


def test_an_episode_is_printed_without_torch_and_matplotlib():
    code = "import sys, carrl.cli.text.episode_text; sys.exit(not {'torch', 'matplotlib'}.isdisjoint(sys.modules))"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_a_car_with_pedals_has_a_column_for_each_control_and_its_speed(pedals):
    text = printed(pedals, width=140)
    rows = table_of(text)
    assert text[text.index("step  ") :].splitlines()[0].split()[6:9] == ["m/s", "steer", "pedal"]
    assert [" ".join(rows[step]).split("▄▃ ")[1].split()[:3] for step in (0, 1)] == [
        ["0.0", "+0.00", "+1.00"],
        ["2.0", "+0.00", "+1.00"],
    ]
    assert "-1.000" in rows[0][-1]  # the algorithm's own column
    assert "speed, m/s" in text


def test_a_line_by_speed_has_digits_without_colours_and_a_legend(pedals):
    lines = [line.rstrip() for line in printed(pedals).splitlines()]
    assert "S start  0 0.0 m/s  9 7.0 m/s  E the record ends" in lines
    assert "9" in "".join(lines[1 : lines.index("S start  0 0.0 m/s  9 7.0 m/s  E the record ends")])
    assert "\x1b[38;2;255;246;192m" in printed(pedals, colours=True)  # of the greatest speed


def test_of_a_table_of_actions_only_the_values_of_the_chosen_and_the_best_one_are_shown(trace):
    actions = len(trace.scene.action_names) + 12
    values = np.tile(np.arange(actions, dtype=np.float32), (len(trace), 1))
    names = tuple(f"steer_{number}" for number in range(actions))
    scene = replace(trace.scene, action_names=names)
    text = printed(EpisodeTrace(scene, {**trace.columns, "action_value": values}), width=160)
    heading = next(line for line in text.splitlines() if "nearest wall" in line)
    assert "chosen" in heading and "best" in heading
    assert "steer_14" not in heading
