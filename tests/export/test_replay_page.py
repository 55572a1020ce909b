"""The replay page in a headless Chromium: every control, what is drawn, what the log may contain, on any screen."""

import io
import itertools
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from carrl.errors import CarrlError
from carrl.export.page import replay_page, write_replay_page
from carrl.log.laps import RecordedLap
from carrl.log.trace import EpisodeTrace
from carrl.render.colours import LIGHT
from tests.export.browsing import Tabs, browser, tabs  # noqa: F401 (fixtures)

MINUS, DASH = "\N{MINUS SIGN}", "\N{EN DASH}"
CAR, VERMILLION, BLUE, GREEN = "#f0e442", "#d55e00", "#0072b2", "#009e73"
ROAD, WALL, GROUND, BLACK = "#dfe2e4", "#59646b", "#ffffff", "#000000"
DARK_ROAD, DARK_GROUND = "#333d44", "#191f23"
DESKTOP, TABLET, PHONE = (1200, 760), (768, 1024), (360, 740)


@pytest.fixture
def open_page(tabs: Tabs, trace: EpisodeTrace, tmp_path: Path) -> Iterator[Callable[..., Any]]:  # noqa: F811
    """Opens the page of an episode as a file; the test fails if it reports an error or asks for an address."""
    own, numbers = [], itertools.count()

    def open_page(episode=trace, link="", *, title="An episode", size=DESKTOP, paused_clock=False, media=(), **options):
        path = tmp_path / f"episode_{next(numbers)}.html"
        write_replay_page(path, episode, title)
        page = tabs.shared
        if options or paused_clock:
            own.append(page := tabs.open(**options))
        page.set_viewport_size({"width": size[0], "height": size[1]})
        page.emulate_media(**{"color_scheme": "light", "reduced_motion": "no-preference", **dict(media)})
        if paused_clock:
            page.clock.install(time=0)
        page.goto(f"{path.as_uri()}{link}")
        page.wait_for_selector("#read-step:not(:empty)")
        if paused_clock:
            page.clock.pause_at(60_000)
        return page

    tabs.complaints.clear()
    yield open_page
    for page in own:
        page.close()
    assert tabs.complaints == []


def state(page, name):
    return page.evaluate("(name) => window.carrl[name]", name)


def text(page, name):
    next_frame(page)
    return page.inner_text(f"#{name}")


def next_frame(page):
    """Waits until what was asked for is drawn."""
    page.evaluate("() => new Promise((drawn) => requestAnimationFrame(() => requestAnimationFrame(drawn)))")


def picture(page, name="track"):
    """The canvas as it is shown, [H, W, 3]; one pixel for each CSS pixel."""
    next_frame(page)
    with Image.open(io.BytesIO(page.locator(f"#{name}").screenshot(animations="disabled"))) as image:
        return np.asarray(image.convert("RGB")).astype(int)


def coloured(pixels, colour, tolerance=6):
    """Which pixels have this colour, [H, W]."""
    wanted = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
    return (np.abs(pixels - wanted) <= tolerance).all(axis=-1)


def lines_of(chart):
    """The part of the Q-values' chart in which its lines are: not the axes, the ribbon and the bars."""
    return chart[:-34, 46:-70]


def around(page, pixels, x, y, radius=0):
    """The pixels about a place on the track, in metres."""
    column, row = np.round(page.evaluate("([x, y]) => window.carrl.place(x, y)", [float(x), float(y)])).astype(int)
    return pixels[row - radius : row + radius + 1, column - radius : column + radius + 1]


def centre(mask):
    """Mean column and row of the pixels that are set."""
    rows, columns = mask.nonzero()
    assert len(rows) > 0, "no pixel has this colour"
    return columns.mean(), rows.mean()


def with_columns(trace, **columns):
    return replace(trace, columns={**trace.columns, **columns})


def lengthened(trace, steps):
    """The same way driven again and again, forwards and backwards."""
    order = np.concatenate([np.arange(len(trace)), np.arange(len(trace))[::-1]])
    order = np.resize(order, steps)
    columns = {name: column[order] for name, column in trace.columns.items()}
    columns |= {"step": np.arange(steps), "time_ns": np.arange(steps) * 100_000_000}
    return replace(trace, columns=columns)


# The file


def test_the_page_is_one_file_that_names_no_address(trace):
    page = replay_page(trace, "An episode")
    assert re.findall(r"https?://[\w./]+", page) == ["http://www.w3.org/2000/svg"]  # a name of SVG's, not fetched
    assert not re.search(r"<(script|img|iframe)[^>]* src=|<link[^>]* href=\"(?!data:)|@import|url\(", page)
    assert "default-src 'none'" in page


def test_the_same_episode_makes_the_same_page(trace):
    assert replay_page(trace, "An episode") == replay_page(trace, "An episode")


def test_400_steps_fit_into_100_kilobytes(trace):
    noise = np.random.default_rng(0).normal(size=(400, 3)).astype(np.float32)
    long = with_columns(lengthened(trace, 400), action_value=100 + noise, pose=noise)
    assert len(replay_page(long, "An episode").encode()) < 100_000


def test_an_interrupted_write_leaves_the_old_page_and_no_rest(trace, tmp_path, monkeypatch):
    path = tmp_path / "episode.html"
    path.write_text("old")

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", fail)
    with pytest.raises(CarrlError, match="cannot be written: No space left on device"):
        write_replay_page(path, trace, "An episode")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_title_that_is_no_proper_text_is_written_all_the_same(trace, tmp_path):
    write_replay_page(tmp_path / "episode.html", trace, "runs/\udcff.mcap")
    assert "runs/" in (tmp_path / "episode.html").read_text(encoding="utf-8")


def test_making_a_page_loads_neither_torch_nor_matplotlib():
    code = "import sys, carrl.export.page; sys.exit(bool({'torch', 'matplotlib'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


# What it shows


def test_the_page_opens_at_the_first_step_and_does_not_play(open_page):
    page = open_page(title="Lap 7")
    assert page.title() == "Lap 7"
    assert page.inner_text("h1") == "Lap 7"
    assert (state(page, "step"), state(page, "steps"), state(page, "playing")) == (0, 14, False)
    assert text(page, "ended") == "ended by a collision"
    assert text(page, "facts") == "Track square · 56 m · 4 gates · episode 7 · car 2 · 14 steps"


def test_the_readings_are_those_of_the_step_in_the_log(open_page):
    page = open_page(link="#step=7")
    readings = {name: text(page, f"read-{name}") for name in ("step", "action", "reward", "time", "gates", "return")}
    assert readings == {
        "step": "7",
        "action": "left\ngreedy",
        "reward": "+50",
        "time": "0.7 s",
        "gates": "0",
        "return": "0",
    }
    assert text(page, "terms").split("\n") == ["collision", "0", "proximity", "0", "gate", "+50", "steering", "0"]
    assert text(page, "value-list").split("\n") == ["forward", "103.28", "left", "114.95", "right", "102.06"]
    assert page.inner_text("#value-list .taken") == "left\n114.95"
    assert text(page, "nearest") == "nearest 2.1 m, 90° L"
    page.keyboard.press("ArrowRight")
    assert (text(page, "read-gates"), text(page, "read-return")) == ("1", "50")


def test_an_exploratory_action_is_called_so(open_page):
    page = open_page(link="#step=6")
    assert text(page, "read-action") == "right\nexploratory"
    assert text(page, "read-epsilon") == "0.154"


def test_after_the_last_step_the_end_is_named_and_no_action(open_page):
    page = open_page(link="#step=14")
    assert text(page, "read-action") == "collision"
    assert (text(page, "read-return"), text(page, "read-reward")) == (f"{MINUS}170", DASH)


def test_the_car_is_drawn_where_the_log_says(open_page, trace):
    page = open_page()
    for step in (0, 4, 11):
        page.evaluate("(step) => { location.hash = `step=${step}`; }", step)
        page.locator("#read-step", has_text=re.compile(f"^{step}$")).wait_for()
        drawn = centre(coloured(picture(page), CAR))
        x, y, heading = trace.poses[step].tolist()
        expected = page.evaluate("([x, y]) => window.carrl.place(x, y)", [x, y])
        assert np.linalg.norm(np.subtract(drawn, expected)) < 8
        # The nose draws the middle of the colour towards the heading.
        assert np.subtract(drawn, expected) @ (np.cos(heading), -np.sin(heading)) > 0


def test_road_walls_and_ground_are_where_they_belong(open_page):
    page = open_page()
    pixels = picture(page)
    for x, y in [(3, 3), (17, 12), (3, 18)]:
        assert coloured(around(page, pixels, x, y), ROAD).all()
    for x, y in [(10, 20), (20, 3), (6, 9), (0, 16)]:
        assert coloured(around(page, pixels, x, y, 1), WALL).any()
    for x, y in [(10, 10), (7, 13), (-0.5, 10)]:
        assert coloured(around(page, pixels, x, y), GROUND).all()


def test_gates_are_white_lines_and_the_start_line_is_chequered(open_page):
    page = open_page()
    pixels = picture(page)
    assert coloured(around(page, pixels, 17, 10), "#ffffff").all()
    start = around(page, pixels, 10, 1.2, 12)
    assert coloured(start, BLACK).any() and coloured(start, "#ffffff").any()


def test_the_line_driven_so_far_has_the_colours_of_its_actions(open_page):
    page = open_page(link="#step=12")
    pixels = picture(page)
    assert coloured(around(page, pixels, 10.7, 3, 1), BLACK).any()
    assert coloured(around(page, pixels, 14.7, 4.4, 1), VERMILLION).any()
    assert coloured(around(page, pixels, 15.4, 8.7, 1), BLUE).any()
    assert not coloured(around(page, pixels, 15.8, 19, 3), BLACK).any()  # not yet driven


def test_going_back_takes_the_line_back(open_page):
    page = open_page(link="#step=12")
    picture(page)
    page.keyboard.press("Home")
    assert not coloured(around(page, picture(page), 14.7, 4.4, 2), VERMILLION).any()


def test_rays_end_where_the_log_says_and_stand_out_near_a_wall(open_page, trace):
    page = open_page(link="#step=5")
    ends = trace.ray_ends()[5]
    pixels = picture(page)
    assert coloured(around(page, pixels, *ends[0], 2), GREEN).any()  # 4.95 m to the right
    assert not coloured(around(page, pixels, *ends[4], 2), GREEN).any()  # 1.05 m to the left
    page.keyboard.press("End")
    assert coloured(picture(page), "#b8397f").sum() > 30


def test_a_gate_that_was_just_passed_shines(open_page):
    page = open_page(link="#step=7")
    assert not coloured(around(page, picture(page), 19.5, 10, 2), GREEN).any()
    page.keyboard.press("ArrowRight")
    assert coloured(around(page, picture(page), 19.5, 10, 2), GREEN).any()


def test_the_view_that_follows_the_car_has_it_in_the_middle(open_page):
    page = open_page(link="#step=9")
    page.keyboard.press("f")
    pixels = picture(page)
    height, width, _ = pixels.shape
    middle = pixels[height // 2 - 40 : height // 2 + 40, width // 2 - 40 : width // 2 + 40]
    assert state(page, "following")
    assert centre(coloured(middle, CAR)) == pytest.approx((40, 40), abs=6)
    page.click("#follow")
    assert not state(page, "following")


def test_the_charts_show_each_action_and_both_signs_of_reward(open_page):
    page = open_page(link="#step=3")
    values = lines_of(picture(page, "value-chart"))
    for colour in (BLACK, VERMILLION, BLUE):
        assert coloured(values, colour).sum() > 50
    rewards = picture(page, "reward-chart")
    assert coloured(rewards, GREEN).any() and coloured(rewards, "#b8397f").any()


def test_a_sharp_screen_gets_sharp_canvases(open_page):
    page = open_page(device_scale_factor=2)
    size = page.locator("#track").evaluate("(canvas) => [canvas.width, canvas.clientWidth]")
    assert size[0] == 2 * size[1]


# Controls


def test_button_and_space_play_and_pause(open_page):
    page = open_page(paused_clock=True)
    page.click("#play-pause")
    page.clock.run_for(400)
    assert state(page, "playing")
    assert 3 <= state(page, "step") <= 4
    assert page.get_attribute("#play-pause", "aria-label") == "Pause"
    page.evaluate("() => document.activeElement.blur()")
    page.keyboard.press("Space")
    assert not state(page, "playing")
    stopped = state(page, "step")
    page.clock.run_for(400)
    assert state(page, "step") == stopped


def test_the_replay_stops_at_the_end_and_starts_again_from_there(open_page):
    page = open_page(link="#step=12", paused_clock=True)
    page.keyboard.press("Space")
    page.clock.run_for(1000)
    assert (state(page, "step"), state(page, "playing")) == (14, False)
    page.keyboard.press("Space")
    page.clock.run_for(100)
    assert state(page, "playing") and state(page, "step") < 3


def test_at_speed_one_simulated_time_is_real_time(open_page):
    page = open_page(paused_clock=True)
    for speed, milliseconds, slack in [(0.25, 2000, 1), (1, 500, 1), (4, 125, 1), (16, 32, 3)]:
        page.select_option("#speed", str(speed))
        page.evaluate("() => document.activeElement.blur()")
        page.keyboard.press("Home")
        page.keyboard.press("Space")
        page.clock.run_for(milliseconds)
        assert state(page, "step") == pytest.approx(5, abs=slack), speed
        page.keyboard.press("Space")


def test_keys_step_jump_and_change_the_speed(open_page):
    page = open_page()
    steps = {"ArrowRight": 1, "Shift+ArrowRight": 11, "ArrowLeft": 10, "Shift+ArrowLeft": 0, "End": 14, "Home": 0}
    for key, step in steps.items():
        page.keyboard.press(key)
        assert state(page, "step") == step, key
    speeds = [("]", 2), ("+", 4), ("[", 2), ("-", 1), ("-", 0.5), ("-", 0.25), ("-", 0.25)]
    for key, speed in speeds:
        page.keyboard.press(key)
        assert state(page, "speed") == speed, key
        next_frame(page)
        assert page.input_value("#speed") == str(speed)


def test_buttons_step_back_and_ahead(open_page):
    page = open_page(link="#step=5")
    page.click("#ahead")
    page.click("#ahead")
    page.click("#back")
    assert state(page, "step") == 6


def test_a_focused_control_keeps_its_own_keys(open_page, trace):
    page = open_page(lengthened(trace, 400))
    page.focus("#ahead")
    page.keyboard.press("Space")
    assert (state(page, "step"), state(page, "playing")) == (1, False)
    page.focus("#scrub")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Shift+ArrowRight")
    assert state(page, "step") == 12
    page.keyboard.press("Space")
    assert state(page, "playing")


def test_the_slider_scrubs(open_page):
    page = open_page()
    box = page.locator("#scrub").bounding_box()
    page.mouse.move(box["x"] + 10, box["y"] + box["height"] / 2)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2, steps=3)
    assert state(page, "step") == 7
    page.mouse.move(box["x"] + box["width"] + 50, box["y"] + box["height"] / 2)
    page.mouse.up()
    assert state(page, "step") == 14
    assert page.get_attribute("#scrub", "aria-valuetext") == "step 14, 1.4 s"


@pytest.mark.parametrize("chart", ["value-chart", "reward-chart"])
def test_a_click_or_drag_on_a_chart_goes_to_a_step(open_page, chart):
    page = open_page()
    box = page.locator(f"#{chart}").bounding_box()
    y = box["y"] + box["height"] / 2
    page.mouse.click(box["x"] + box["width"] - 1, y)
    assert state(page, "step") == 14
    page.mouse.move(box["x"] + 46, y)
    page.mouse.down()
    assert state(page, "step") == 0
    page.mouse.move(box["x"] + 140, y)
    assert 2 <= state(page, "step") <= 6
    page.mouse.up()
    page.mouse.move(box["x"] + 46, y)
    assert 2 <= state(page, "step") <= 6


def test_the_keys_are_shown_and_hidden(open_page):
    page = open_page()
    page.keyboard.press("?")
    assert page.is_visible("#keys")
    page.keyboard.press("ArrowRight")
    assert state(page, "step") == 0
    page.keyboard.press("?")
    assert page.is_hidden("#keys")
    page.click("#show-keys")
    page.click("#keys button")
    assert page.is_hidden("#keys")


# Links


@pytest.mark.parametrize(
    ("link", "step"), [("#step=9", 9), ("#step=999", 14), ("#step=-3", 0), ("#step=x", 0), ("#", 0)]
)
def test_a_link_opens_its_step(open_page, link, step):
    assert state(open_page(link=link), "step") == step


def test_a_new_link_in_the_open_page_goes_there(open_page):
    page = open_page(link="#step=3")
    page.evaluate("() => { location.hash = '#step=11'; }")
    page.locator("#read-step", has_text="11").wait_for()
    assert state(page, "step") == 11


def test_the_address_follows_the_step_but_not_the_replay(open_page):
    page = open_page(paused_clock=True)
    assert "#" not in page.url
    page.keyboard.press("ArrowRight")
    page.clock.run_for(500)
    assert page.url.endswith("#step=1")
    page.keyboard.press("Space")
    page.clock.run_for(500)
    assert page.url.endswith("#step=1")
    page.keyboard.press("Space")
    page.clock.run_for(500)
    assert page.url.endswith(f"#step={state(page, 'step')}")


def test_the_button_copies_a_link_to_the_step_and_says_so(open_page):
    page = open_page(link="#step=4", permissions=["clipboard-read", "clipboard-write"])
    page.keyboard.press("ArrowRight")
    page.click("#copy-link")
    page.locator("#notice", has_text="Link to step 5 copied").wait_for()
    copied = page.evaluate("() => navigator.clipboard.readText()")
    assert copied == page.url.split("#")[0] + "#step=5"


def test_steps_that_the_log_lacks_are_left_out_and_counted(open_page, trace):
    numbers = np.arange(14) + np.where(np.arange(14) < 5, 100, 107)
    page = open_page(with_columns(trace, step=numbers), link="#step=104")
    assert text(page, "facts").endswith("14 steps · 107 more not in the log")
    assert (text(page, "read-step"), text(page, "read-steps")) == ("104", "of 121")
    page.keyboard.press("ArrowRight")
    assert state(page, "step") == 112
    pixels = picture(page)
    assert coloured(around(page, pixels, 14.7, 4.4, 1), VERMILLION).any()  # from step 103 to 104
    assert not coloured(around(page, pixels, 15, 5.8, 2), VERMILLION).any()  # from 104 on, the way is unknown
    page.keyboard.press("Home")
    page.evaluate("() => { location.hash = '#step=106'; }")
    page.locator("#read-step", has_text="112").wait_for()
    assert state(page, "step") == 112


def test_a_link_may_ask_to_play_unless_motion_is_unwelcome(open_page, trace):
    long = lengthened(trace, 400)
    assert state(open_page(long, link="#play"), "playing")
    assert not state(open_page(long, link="#play", media={"reduced_motion": "reduce"}), "playing")


# Any screen


def test_light_and_dark_follow_the_system_and_the_button(open_page):
    page = open_page(media={"color_scheme": "dark"})
    assert state(page, "dark")
    assert coloured(around(page, picture(page), 3, 3), DARK_ROAD).all()
    assert coloured(around(page, picture(page), 10, 10), DARK_GROUND).all()
    page.click("#theme")
    assert not state(page, "dark")
    assert coloured(around(page, picture(page), 3, 3), ROAD).all()
    page.emulate_media(color_scheme="light")
    page.keyboard.press("t")
    assert state(page, "dark")


@pytest.mark.parametrize("size", [(1440, 900), (1024, 768), TABLET, PHONE, (740, 360)], ids=str)
def test_nothing_overlaps_or_overflows(open_page, size):
    page = open_page(size=size, title="outputs/2026-01-02/10-11-12/train.mcap: episode 7, the best of the last hundred")
    assert page.evaluate("() => document.documentElement.scrollWidth") <= size[0]
    for group in ("h1, .heading p, .tools > *", "#stage, #panels > section", ".buttons > *, .timeline", "dd, dt"):
        boxes = page.locator(group).evaluate_all(
            "(all) => all.map((one) => one.getBoundingClientRect()).map((b) => [b.left, b.top, b.right, b.bottom])"
        )
        boxes = [box for box in boxes if box[2] > box[0]]
        assert len(boxes) >= 5
        for index, (left, top, right, bottom) in enumerate(boxes):
            assert left >= 0 and right <= size[0]
            for other in boxes[:index]:
                apart = left >= other[2] or other[0] >= right or top >= other[3] or other[1] >= bottom
                assert apart, f"{group}: {boxes[index]} and {other}"
    for canvas in ("track", "value-chart", "reward-chart", "sensor-bars"):
        box = page.locator(f"#{canvas}").bounding_box()
        assert box["width"] >= 240 and box["height"] >= 50, canvas


def test_on_a_phone_every_control_is_large_enough_for_a_finger(open_page, trace):
    page = open_page(lengthened(trace, 400), size=PHONE, has_touch=True)
    for control in page.locator("header button, main button, main select, main input").all():
        box = control.bounding_box()
        assert box["width"] >= 44 and box["height"] >= 44, control.get_attribute("id")
    page.tap("#play-pause")
    assert state(page, "playing")


def test_the_canvas_follows_the_size_of_the_window(open_page):
    page = open_page(link="#step=4")
    before = centre(coloured(picture(page), CAR))
    page.set_viewport_size({"width": 800, "height": 1000})
    after = centre(coloured(picture(page), CAR))
    assert after != before
    assert page.locator("#track").evaluate("(canvas) => canvas.width === canvas.clientWidth")


def test_every_control_has_a_name_and_shows_its_focus(open_page):
    page = open_page()
    named = "(one) => (one.getAttribute('aria-label') || one.textContent).trim().length > 1"
    assert page.locator("button, select, input, canvas[role]").evaluate_all(f"(all) => all.every({named})")
    for _ in range(8):
        page.keyboard.press("Tab")
        outline = page.evaluate(
            "() => [document.activeElement.tagName, getComputedStyle(document.activeElement).outlineStyle]"
        )
        assert outline[0] in ("BUTTON", "SELECT", "INPUT") and outline[1] == "solid"


# Whatever the log contains


def test_names_from_the_log_are_text_and_never_markup(open_page, trace):
    hostile = '</script><script>document.title="x"</script><img src=x onerror="document.title=1">$title&lt;'
    track = replace(trace.track, name=hostile)
    scene = replace(
        trace.scene, action_names=(hostile,) * 3, reward_terms=(hostile, "a", "gate", hostile), tracks=(track,)
    )
    page = open_page(replace(trace, scene=scene), title=hostile)
    assert page.title() == hostile
    assert page.inner_text("h1") == hostile
    assert hostile in text(page, "facts")
    assert hostile in text(page, "value-list")
    assert page.locator("img").count() == 0
    assert page.locator("script").count() == 2


def test_values_that_are_no_numbers_leave_gaps(open_page, trace):
    values = trace.columns["action_value"].copy()
    values[3], values[5, 1], values[6, 2] = np.nan, np.inf, -np.inf
    readings = trace.columns["observation"].copy()
    readings[3, 2], readings[4] = np.nan, np.inf
    page = open_page(with_columns(trace, action_value=values, observation=readings), link="#step=3")
    assert text(page, "value-list").split("\n")[1::2] == ["NaN", "NaN", "NaN"]
    assert coloured(lines_of(picture(page, "value-chart")), VERMILLION).sum() > 50
    assert coloured(picture(page), CAR).sum() > 50
    page.keyboard.press("ArrowRight")
    assert text(page, "nearest") == "no reading"
    page.keyboard.press("ArrowRight")
    assert text(page, "value-list").split("\n")[3] == "∞"
    page.keyboard.press("ArrowRight")
    assert text(page, "value-list").split("\n")[5] == f"{MINUS}∞"


def test_an_episode_without_one_finite_value_is_shown(open_page, trace):
    nothing = np.full_like(trace.columns["action_value"], np.nan)
    page = open_page(with_columns(trace, action_value=nothing), link="#step=2")
    assert coloured(picture(page), CAR).any()


def test_an_episode_of_one_step_is_shown(open_page, trace):
    page = open_page(replace(trace, columns={name: column[:1] for name, column in trace.columns.items()}))
    page.keyboard.press("End")
    assert state(page, "step") == 1
    assert coloured(picture(page), CAR).any()


def test_20000_steps_are_shown_at_once(open_page, trace):
    long = lengthened(trace, 20_000)
    page = open_page(long, link="#step=19990")
    assert text(page, "read-step") == "19,990"
    x, y = long.poses[19_990, :2]
    assert coloured(around(page, picture(page), x, y, 3), CAR).any()
    page.keyboard.press("Home")
    assert state(page, "step") == 0


def test_one_peak_among_20000_steps_is_seen(open_page, trace):
    long = lengthened(trace, 20_000)
    long.columns["action_value"][10_000, 1] = 500
    chart = lines_of(picture(open_page(long), "value-chart"))[:, 10:]  # without the line at the step that is shown
    row = chart[len(chart) // 2]
    peak = (row != np.median(row, axis=0)).any(axis=-1).nonzero()[0]
    assert 1 <= len(peak) <= 3
    assert peak.mean() == pytest.approx(chart.shape[1] / 2, abs=8)


def test_a_long_circuit_gets_a_close_up_of_the_car(open_page, trace):
    track = trace.track
    far = {name: getattr(track, name) * 40 for name in ("walls", "gates", "centreline")}
    scene = replace(trace.scene, tracks=(replace(track, **far),))
    page = open_page(replace(trace, scene=scene))
    assert coloured(picture(page), GREEN).sum() > 150  # the rays, which on the whole track are 8 pixels long


def test_the_close_up_is_larger_than_the_whole_track_however_far_the_sensor_sees(open_page, trace):
    far = {name: getattr(trace.track, name) * 40 for name in ("walls", "gates", "centreline")}
    scene = replace(trace.scene, tracks=(replace(trace.track, **far),), sensor_range=1000.0, body_radius=8.0)
    page = open_page(replace(trace, scene=scene))
    assert coloured(picture(page), CAR).sum() > 500  # a disc of 18 pixels, which on the whole track has 6


# A car with pedals


SHADES = LIGHT.speed_shades


def test_the_readings_of_a_car_with_pedals_are_its_controls_its_speed_and_its_motion(open_page, pedals):
    page = open_page(pedals, link="#step=3")
    assert text(page, "read-action").split("\n") == ["steer +0.50", "pedal +0.50"]
    assert text(page, "read-speed") == "6.0 m/s · 22 km/h"
    assert text(page, "read-yaw_rate") == "0.25 rad/s"
    assert text(page, "read-slip") == "0.03 rad"
    assert text(page, "legend").split() == ["speed", "0.0", "7.0", "m/s"]
    assert not page.locator("#values").is_visible()
    page.keyboard.press("End")
    assert (text(page, "read-speed"), text(page, "read-action")) == ("4.5 m/s · 16 km/h", "unfinished")


def test_a_car_that_hardly_moves_has_the_speed_0(open_page, pedals):
    states = pedals.columns["state"].copy()
    states[0, 3] = 5e-4
    page = open_page(replace(pedals, columns={**pedals.columns, "state": states}))
    assert text(page, "read-speed") == "0.0 m/s · 0 km/h"
    assert text(page, "legend").split() == ["speed", "0.0", "7.0", "m/s"]


def test_a_car_without_pedals_has_no_instruments(open_page):
    page = open_page()
    assert not page.locator("#instruments").is_visible()
    assert "forward" in text(page, "legend") and "m/s" not in text(page, "legend")


def test_the_wheel_turns_to_the_side_that_is_steered_to(open_page, pedals):
    page, tops = open_page(pedals), []
    for step in (0, 4, 7):  # straight on, to the left, to the right
        page.evaluate("(step) => { location.hash = `step=${step}`; }", step)
        page.locator("#read-step", has_text=re.compile(f"^{step}$")).wait_for()
        dials = picture(page, "dials")
        wheel = dials[:, : dials.shape[1] // 3]
        tops.append(centre(coloured(wheel, GREEN))[0] - centre(coloured(wheel, "#1a2126"))[0])
    assert tops[1] < -10 < tops[0] < 10 < tops[2]


def test_the_pedals_are_as_far_down_as_the_control_says(open_page, pedals):
    page, heights = open_page(pedals), []
    for step, colour in ((0, GREEN), (3, GREEN), (5, "#b8397f"), (6, "#b8397f")):
        page.evaluate("(step) => { location.hash = `step=${step}`; }", step)
        page.locator("#read-step", has_text=re.compile(f"^{step}$")).wait_for()
        dials = picture(page, "dials")
        third = dials.shape[1] // 3
        heights.append(coloured(dials[:, third : 2 * third], colour).any(axis=1).sum())
    full = heights[0]
    assert heights == pytest.approx([full, full / 2, full / 2, full], abs=2)


def test_the_dot_of_the_accelerations_is_at_the_side_the_car_is_pressed_to(open_page, pedals):
    page = open_page(pedals, link="#step=5")
    dials = picture(page, "dials")
    friction = dials[:, 2 * dials.shape[1] // 3 :]
    column, row = centre(coloured(friction, VERMILLION))
    middle = np.array(friction.shape[1::-1]) / 2 - (0, 8)
    assert column < middle[0] - 10  # 7 m/s2 to the left
    assert abs(row - middle[1]) < 4  # the speed stays
    assert coloured(friction, "#b8397f", 40).any()  # the circle of friction


def test_the_line_of_a_car_whose_speed_varies_has_the_colours_of_its_speed(open_page, pedals):
    page = open_page(pedals, link="#step=8")
    pixels = picture(page)
    for step, shade in ((1, 6), (2, 13)):  # the car stands on the others
        x, y = (pedals.poses[step, :2] + pedals.poses[step + 1, :2]) / 2
        assert coloured(around(page, pixels, x, y, 1), SHADES[shade], 12).any()


def test_the_rectangle_is_drawn_to_scale_with_its_heading(open_page, pedals):
    page = open_page(pedals, link="#step=8")
    pixels = picture(page)
    (x, y, heading), size = pedals.poses[8], np.array([2.0, 0.9])
    ahead, aside = np.array([np.cos(heading), np.sin(heading)]), np.array([-np.sin(heading), np.cos(heading)])
    for along, across, inside in ((-0.8, 0.7, True), (-0.8, -0.7, True), (-1.2, 0.0, False), (-0.5, 1.4, False)):
        place = np.array([x, y]) + along * size[0] * ahead + across * size[1] * aside
        assert coloured(around(page, pixels, *place, 1), CAR).any() == inside


def test_a_click_on_the_speed_goes_to_its_step(open_page, pedals):
    page = open_page(pedals)
    box = page.locator("#speed-chart").bounding_box()
    page.mouse.click(box["x"] + 44 + (box["width"] - 60) / 2, box["y"] + box["height"] / 2)
    assert state(page, "step") == 4


def test_a_page_without_rays_has_no_chart_of_them(open_page, pedals):
    blind = replace(pedals, scene=replace(pedals.scene, observation=(), sensor_angles=np.zeros(0)))
    page = open_page(blind, link="#step=2")
    assert not page.locator("#sensors").is_visible()
    assert text(page, "read-step") == "2"


def test_a_lap_is_timed_in_the_facts_and_in_the_readings_after_it(open_page, trace, monkeypatch):
    laps = [RecordedLap(3, 61.234, True), RecordedLap(9, 55.5, False)]
    monkeypatch.setattr("carrl.export.page.recorded_laps", lambda episode: laps)
    page = open_page(link="#step=3")
    assert "· 14 steps · 2 laps, best 61.23 s" in text(page, "facts")
    assert text(page, "read-lap") == DASH
    page.keyboard.press("ArrowRight")
    assert text(page, "read-lap") == "61.23 s"
    page.keyboard.press("End")
    assert text(page, "read-lap") == "55.50 s, with contact"
