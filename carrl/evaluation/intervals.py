"""Confidence intervals of shares, rates and means of few drives."""

import math
from collections.abc import Sequence

CONFIDENCE = 0.95

Interval = tuple[float, float]


def share_interval(successes: int, trials: int) -> Interval:
    """Wilson's interval of the probability of a success; all of 0..1 if nothing was tried.

    Source: Wilson 1927, "Probable Inference, the Law of Succession, and Statistical Inference".
    """
    from scipy import special  # Here and below, since training imports this module and needs none of it.

    if trials == 0:
        return 0.0, 1.0
    z = float(special.ndtri((1 + CONFIDENCE) / 2))
    share, penalty = successes / trials, z * z / trials
    middle = (share + penalty / 2) / (1 + penalty)
    reach = z / (1 + penalty) * math.sqrt(share * (1 - share) / trials + penalty / (4 * trials))
    return max(0.0, middle - reach), min(1.0, middle + reach)


def rate_interval(events: int, exposure: float) -> Interval:
    """The exact interval of a Poisson rate: events per unit of the exposure, which must be positive.

    Source: Garwood 1936, "Fiducial Limits for the Poisson Distribution".
    """
    from scipy import special

    tail = (1 - CONFIDENCE) / 2
    low = special.gammaincinv(events, tail) if events else 0.0
    return float(low) / exposure, float(special.gammainccinv(events + 1, tail)) / exposure


def mean_interval(values: Sequence[float]) -> Interval | None:
    """Student's interval of the mean of independent values; None of fewer than two.

    Source: Student 1908, "The Probable Error of a Mean".
    """
    from scipy import special

    count = len(values)
    if count < 2:
        return None
    mean = math.fsum(values) / count
    variance = math.fsum((value - mean) ** 2 for value in values) / (count - 1)
    reach = float(special.stdtrit(count - 1, (1 + CONFIDENCE) / 2)) * math.sqrt(variance / count)
    return mean - reach, mean + reach
