"""Lines across the road and the moment at which they are crossed, by numbers worked by hand."""

import numpy as np
import pytest

from carrl.sim.crossing import AT_LINE, crossing_shares, time_shares

LINE = np.array([(0.0, 1.0), (0.0, -1.0)])
"""Across the way of a car that drives along +x."""


def share(begin, end):
    return crossing_shares(LINE, np.array([begin], dtype=float), np.array([end], dtype=float))[0]


def test_a_line_a_quarter_of_the_way_ahead_is_crossed_after_a_quarter_of_it():
    assert share((-1, 0.5), (3, 0.5)) == pytest.approx(0.25)


def test_a_way_askew_crosses_where_it_meets_the_line():
    assert share((-1, -0.5), (1, 0.5)) == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("begin", "end"),
    [
        ((3, 0), (-1, 0)),
        ((-1, 2), (3, 2)),
        ((-3, 0), (-1, 0)),
        ((1, 0), (3, 0)),
        ((0, 0), (1, 0)),
        ((np.nan, 0), (1, 0)),
    ],
    ids=["backwards", "beside it", "before it", "behind it", "from on it", "from nowhere"],
)
def test_a_way_that_does_not_cross_forward_between_the_ends_has_no_share(begin, end):
    assert np.isnan(share(begin, end))


def test_a_car_that_stops_on_the_line_has_crossed_it_once():
    assert share((-1, 0), (-AT_LINE / 2, 0)) == pytest.approx(1, abs=AT_LINE)
    assert np.isnan(share((-AT_LINE / 2, 0), (1, 0)))


def test_each_way_may_have_a_line_of_its_own():
    lines = np.stack([LINE, LINE + np.array([2.0, 0.0])])
    begin, end = np.array([(-1.0, 0), (-1.0, 0)]), np.array([(3.0, 0), (3.0, 0)])
    assert crossing_shares(lines, begin, end) == pytest.approx([0.25, 0.75])


def test_at_a_constant_speed_the_time_passes_as_the_way_does():
    assert time_shares(np.array([0.25]), np.array([7.0]), np.array([7.0])) == pytest.approx([0.25])


def test_a_quarter_of_the_way_from_rest_takes_half_of_the_time():
    """A way of a t^2 / 2: half of the time makes a quarter of it."""
    assert time_shares(np.array([0.25]), np.array([0.0]), np.array([8.0])) == pytest.approx([0.5])


def test_a_car_that_brakes_to_rest_needs_a_quarter_of_its_time_for_seven_sixteenths_of_its_way():
    """With 1 - (1 - t)^2 of the way done at the share t of the time."""
    assert time_shares(np.array([7 / 16]), np.array([8.0]), np.array([0.0])) == pytest.approx([0.25])


def test_a_car_that_stands_has_no_time_that_is_no_number():
    assert time_shares(np.array([0.5]), np.array([0.0]), np.array([0.0])) == pytest.approx([0.5])
