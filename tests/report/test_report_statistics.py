"""Figures of groups and pairs, by numbers worked by hand."""

import math

import numpy as np
import pytest
from scipy.stats import mannwhitneyu

from carrl.report.measures import (
    holm,
    improvement,
    iqm,
    iqm_band,
    iqm_estimate,
    least_p,
    p_value,
    share_band,
)

NEVER = math.inf


@pytest.mark.parametrize(
    ("scores", "mean"),
    [
        ([8, 1, 7, 2, 6, 3, 5, 4], 4.5),  # without 1, 2 and 7, 8
        ([1000, 0, 100, 0, 10], 110 / 3),  # a quarter of five runs is one
        ([1, 2, 9], 4),  # of three none
        ([5], 5),
    ],
)
def test_the_interquartile_mean_leaves_out_a_quarter_on_each_side(scores, mean):
    assert iqm(np.array(scores, dtype=float)) == pytest.approx(mean)


def test_the_interval_of_two_runs_reaches_from_one_to_the_other():
    estimate = iqm_estimate([0.0, 1.0])
    assert (estimate.value, estimate.low, estimate.high) == (0.5, 0.0, 1.0)  # a quarter of the resamples are 0, 0


def test_equal_runs_have_no_width_and_a_single_run_no_interval():
    estimate = iqm_estimate([3.0] * 6)
    assert (estimate.low, estimate.high) == (3.0, 3.0)
    assert math.isnan(iqm_estimate([3.0]).low)


def test_the_interval_covers_the_mean_of_a_normal_sample_about_as_often_as_it_says():
    generator = np.random.default_rng(1)
    estimates = [iqm_estimate(generator.normal(size=20)) for _ in range(200)]
    covered = np.mean([estimate.low <= 0 <= estimate.high for estimate in estimates])
    assert 0.88 <= covered <= 0.99


def test_a_band_is_the_estimate_at_each_point():
    curves = np.array([[0.0, 5.0], [0.0, 6.0], [0.0, 7.0], [0.0, 8.0]])
    band = iqm_band(curves)
    assert band.value.tolist() == [0.0, 6.5]  # without 5 and 8
    assert band.low[0] == band.high[0] == 0.0
    assert 5 <= band.low[1] < 6.5 < band.high[1] <= 8


def test_a_share_has_the_interval_of_a_binomial():
    band = share_band(np.array([[True, False]] * 5 + [[True, True]] * 5))
    assert band.value.tolist() == [1.0, 0.5]
    assert (band.low[0], band.high[0]) == (1.0, 1.0)
    assert (band.low[1], band.high[1]) == pytest.approx((0.2, 0.8))  # of Binomial(10, 1/2) / 10


def test_the_probability_of_improvement_counts_ties_half():
    # 3 beats 2, ties 3, loses to 4; 5 beats all three: 4.5 of 6
    assert improvement([3, 5], [2, 3, 4]).value == pytest.approx(0.75)
    assert improvement([2, 3, 4], [3, 5]).value == pytest.approx(0.25)


def test_a_lap_that_never_came_is_later_than_all_and_ties_with_its_like():
    laps, others = [-100, -NEVER], [-200, -300]
    assert improvement(laps, others).value == 0.5  # 100 beats both, never loses to both
    assert improvement([-100, -NEVER], [-100, -NEVER]).value == 0.5  # a tie, a win, a loss, a tie


def test_the_interval_of_an_improvement_is_that_of_both_groups_resampled():
    chance = improvement([1, 1, 0, 0], [0.5] * 4)
    assert (chance.value, chance.low, chance.high) == (0.5, 0.0, 1.0)  # of Binomial(4, 1/2) / 4: P(0) = 1/16
    assert improvement([2, 3], [0, 1]).low == 1.0
    assert math.isnan(improvement([2], [0, 1]).low)


@pytest.mark.parametrize(
    ("first", "second", "p"),
    [
        ([1, 2, 3], [4, 5, 6], 2 / 20),  # 1 of the 20 ways to divide six is as extreme, on either side
        ([4, 5, 6, 7, 8], [1, 2, 3, -1, 0], 2 / 252),
        ([1, 1, 2], [2, 3, 3], 2 * 2 / 20),  # either 2 may be the first group's
        ([1, NEVER], [NEVER, 1], 1.0),
        ([400, 400, 400], [400, 400], 1.0),
    ],
)
def test_p_is_the_share_of_divisions_as_extreme(first, second, p):
    assert p_value(first, second) == pytest.approx(p)


def test_p_without_ties_is_that_of_scipys_exact_test():
    generator = np.random.default_rng(0)
    for sizes in ((2, 9), (7, 7), (12, 5), (40, 30)):
        first, second = (generator.normal(size=size) for size in sizes)
        exact = mannwhitneyu(first, second, method="exact").pvalue
        assert p_value(first, second) == pytest.approx(p_value(second, first)) == pytest.approx(exact)


def test_holms_correction_multiplies_the_least_p_by_most_and_keeps_the_order():
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([0.6, 0.7]) == pytest.approx([1.0, 1.0])
    assert holm([]) == []


def test_the_least_p_is_that_of_complete_separation():
    assert least_p(3, 3) == pytest.approx(p_value([1, 2, 3], [4, 5, 6]))
    assert least_p(1, 1) == 1.0
