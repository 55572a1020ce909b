"""95 % confidence intervals of what drives are measured by: shares, means and rates."""

import math
from collections.abc import Sequence

from scipy import stats

CONFIDENCE = 0.95

Interval = tuple[float, float]


def share_interval(successes: int, trials: int) -> Interval:
    """Wilson's interval of the probability of a success; all of 0..1 if nothing was tried.

    Source: Wilson 1927, "Probable Inference, the Law of Succession, and Statistical Inference".
    """
    if trials == 0:
        return 0.0, 1.0
    z = float(stats.norm.ppf((1 + CONFIDENCE) / 2))
    share, penalty = successes / trials, z * z / trials
    middle = (share + penalty / 2) / (1 + penalty)
    reach = z / (1 + penalty) * math.sqrt(share * (1 - share) / trials + penalty / (4 * trials))
    return max(0.0, middle - reach), min(1.0, middle + reach)


def rate_interval(events: int, exposure: float) -> Interval:
    """The exact interval of a Poisson rate: events per unit of the exposure, which must be positive.

    Source: Garwood 1936, "Fiducial Limits for the Poisson Distribution".
    """
    tail = (1 - CONFIDENCE) / 2
    low = stats.chi2.ppf(tail, 2 * events) / 2 if events else 0.0
    return float(low) / exposure, float(stats.chi2.isf(tail, 2 * events + 2)) / 2 / exposure


def mean_interval(values: Sequence[float]) -> Interval | None:
    """Student's interval of the mean of independent values; None of fewer than two.

    Source: Student 1908, "The Probable Error of a Mean".
    """
    count = len(values)
    if count < 2:
        return None
    mean = math.fsum(values) / count
    variance = math.fsum((value - mean) ** 2 for value in values) / (count - 1)
    reach = float(stats.t.ppf((1 + CONFIDENCE) / 2, count - 1)) * math.sqrt(variance / count)
    return mean - reach, mean + reach
