"""Confidence intervals, against numbers worked by hand."""

import math

import pytest

from carrl.evaluation.intervals import mean_interval, rate_interval, share_interval

Z = 1.959964


def test_eight_laps_of_eight_say_that_at_least_two_thirds_are_completed():
    assert share_interval(8, 8) == pytest.approx((8 / (8 + Z**2), 1.0))


def test_half_of_ten_is_wilsons_textbook_interval():
    assert share_interval(5, 10) == pytest.approx((0.2366, 0.7634), abs=1e-4)


def test_no_success_mirrors_no_failure():
    low, high = share_interval(3, 12)
    assert share_interval(9, 12) == pytest.approx((1 - high, 1 - low))
    assert share_interval(0, 0) == (0.0, 1.0)


def test_no_collision_in_10_km_leaves_room_for_a_third_of_one_per_km():
    assert rate_interval(0, 10.0) == pytest.approx((0.0, -math.log(0.025) / 10))


def test_one_collision_has_the_exact_poisson_interval():
    low, high = rate_interval(1, 2.0)
    assert low == pytest.approx(-math.log(0.975) / 2)
    # The probability of at most one event at the upper end is 2.5 %.
    assert math.exp(-2 * high) * (1 + 2 * high) == pytest.approx(0.025)


def test_the_mean_of_three_values_has_students_interval():
    reach = 4.302653 * math.sqrt(1 / 3)  # Student's quantile with 2 degrees of freedom; the variance is 1
    assert mean_interval([1.0, 2.0, 3.0]) == pytest.approx((2 - reach, 2 + reach))


def test_one_value_has_no_interval():
    assert mean_interval([1.0]) is None
