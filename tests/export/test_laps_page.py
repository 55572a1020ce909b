"""The page of laps in a headless Chromium: where cars and gaps are, and that every control does what it says."""

import re

import pytest

from carrl.export.laps_page import write_laps_page
from carrl.racing.laps import Lap
from tests.driven_laps import moments, steady, steady_lap
from tests.export.browsing import browser, tabs  # noqa: F401 (fixtures)
from tests.racing.laps import RADIUS, ring

DESKTOP, PHONE = (1280, 800), (420, 900)


@pytest.fixture(scope="module")
def laps():
    """At 20 m/s, at 16 m/s, and at 20 m/s as far as 100 m."""
    road = ring()
    return [steady_lap(road, 20.0, "fast"), steady_lap(road, 16.0, "slow"), steady_lap(road, 20.0, "part", end=100.0)]


@pytest.fixture
def open_page(tabs, laps, tmp_path):  # noqa: F811
    def open_page(shown=laps, link="", size=DESKTOP, scheme="light"):
        path = tmp_path / "laps.html"
        write_laps_page(path, ring(), shown)
        page = tabs.shared
        page.set_viewport_size({"width": size[0], "height": size[1]})
        page.emulate_media(color_scheme=scheme, reduced_motion="no-preference")
        page.goto("about:blank")
        page.goto(f"{path.as_uri()}{link}")
        page.wait_for_function("() => window.carrl && document.querySelectorAll('#laps tr').length > 0")
        return page

    tabs.complaints.clear()
    yield open_page
    assert tabs.complaints == []


def state(page, name):
    page.evaluate("() => new Promise((drawn) => requestAnimationFrame(() => requestAnimationFrame(drawn)))")
    return page.evaluate("(name) => window.carrl[name]", name)


def cells(page, index):
    """Of a row of the table: the name, lap time, sectors, speed and gap."""
    state(page, "time")
    return page.locator("#laps tr").nth(index).locator("th, td").all_inner_texts()


def test_cars_are_where_they_were_at_the_same_time(open_page):
    page = open_page(link="#step=80")
    assert state(page, "time") == pytest.approx(4)
    fast, slow, part = state(page, "cars")
    assert [car["station"] for car in (fast, slow, part)] == pytest.approx([80, 64, 80], abs=0.05)
    assert (fast["x"] ** 2 + fast["y"] ** 2) ** 0.5 == pytest.approx(RADIUS, abs=0.05)
    assert [fast["gap"], slow["gap"]] == pytest.approx([0, 64 / 16 - 64 / 20], abs=2e-3)


def test_the_table_has_lap_times_sectors_and_what_is_now(open_page):
    page = open_page(link="#step=80")
    assert cells(page, 0) == ["fast", "12.57", "4.19", "4.19", "4.19", "20.0", ""]
    assert cells(page, 1) == ["slow", "15.71", "5.24", "5.24", "5.24", "16.0", "+0.80"]
    part = cells(page, 2)
    assert "ended at 100 m" in part[0] and part[1:5] == ["–", "4.19", "–", "–"]  # noqa: RUF001


def test_another_lap_becomes_the_reference_and_its_car_stays_in_its_place(open_page):
    page = open_page(link="#step=80")
    page.get_by_label("Gaps to slow").check()
    assert state(page, "cars")[1]["station"] == pytest.approx(64, abs=0.05)
    assert cells(page, 0)[-1] == "−0.80" or cells(page, 0)[-1].startswith("−")  # noqa: RUF001
    assert page.evaluate("() => window.carrl.gap(0, 160)") == pytest.approx(160 / 20 - 160 / 16, abs=2e-3)


def test_side_by_side_all_cars_are_at_the_distance_of_the_reference(open_page):
    page = open_page(link="#step=80")
    page.click("#together")
    assert state(page, "together")
    assert [car["station"] for car in state(page, "cars")] == pytest.approx([80, 80, 80], abs=0.05)
    assert state(page, "cars")[1]["gap"] == pytest.approx(1, abs=2e-3)
    assert state(page, "duration") == pytest.approx(12.6, abs=0.06)
    page.keyboard.press("End")
    assert state(page, "cars")[2]["station"] == pytest.approx(100, abs=0.05)  # it came no further
    page.keyboard.press("d")
    assert not state(page, "together")
    assert state(page, "duration") == pytest.approx(15.7, abs=0.06)


@pytest.mark.parametrize("chart", ["speed-chart", "gap-chart"])
def test_a_click_on_a_chart_goes_to_the_place(open_page, laps, chart):
    page = open_page()
    box = page.locator(f"#{chart}").bounding_box()
    page.mouse.click(box["x"] + 44 + (box["width"] - 58) / 2, box["y"] + box["height"] / 2)
    assert state(page, "cars")[0]["station"] == pytest.approx(laps[0].length / 2, abs=1.5)


def test_it_plays_to_the_end_of_the_slowest_lap(open_page):
    page = open_page(link="#step=300")
    page.keyboard.press("Space")
    page.wait_for_function("() => !window.carrl.playing && window.carrl.time > 15")
    fast, slow, _ = state(page, "cars")
    assert fast["station"] == pytest.approx(slow["station"], abs=0.05)
    assert slow["gap"] == pytest.approx(slow["station"] / 16 - slow["station"] / 20, abs=5e-3)


def test_the_close_up_and_the_theme_have_their_keys(open_page):
    page = open_page(scheme="dark")
    assert state(page, "dark")
    page.keyboard.press("t")
    page.keyboard.press("f")
    assert not state(page, "dark") and state(page, "following")
    page.click("#follow")
    assert not state(page, "following")


@pytest.mark.parametrize("size", [DESKTOP, (1000, 700), (768, 1024), PHONE], ids=str)
def test_nothing_overflows(open_page, laps, size):
    long = Lap.of("a lap with a rather long name, of yesterday evening", ring(), *steady(ring(), 18.0))
    page = open_page([*laps, long], size=size)
    assert page.evaluate("() => document.documentElement.scrollWidth") <= size[0]
    assert page.evaluate("() => document.querySelector('.table').scrollWidth") <= size[0]
    for canvas in ("track", "speed-chart", "gap-chart"):
        box = page.locator(f"#{canvas}").bounding_box()
        assert box["width"] >= 240 and box["height"] >= 100, canvas
    if size == PHONE:
        for control in page.locator("header button, main button, main select").all():
            box = control.bounding_box()
            assert box["width"] >= 44 and box["height"] >= 44, control.get_attribute("id")


def test_names_are_text_and_never_markup(open_page):
    hostile = '</script><img src=x onerror="document.title=1">$title&lt;'
    page = open_page([steady_lap(ring(), 20.0, hostile)])
    assert cells(page, 0)[0] == hostile
    assert page.locator("img").count() == 0
    assert re.search("Laps of ring", page.title())


def test_a_lap_from_rest_says_so(open_page, laps):
    times = [0.1 * moment for moment in range(104)]
    rest = Lap.of("rest", ring(), *moments(ring(), [2.5 * t**2 for t in times], [5 * t for t in times]))
    assert "from rest" in cells(open_page([rest, *laps]), 0)[0]
