"""How well a policy drives: measures of one drive, of one network's drives, and of many with confidence intervals.

Shapes: `T` steps, `R` rays.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

MEANS = (
    *("progress", "lap_reward", "lap_steps", "forward_share", "switches_per_100m"),
    *("mean_speed", "steering_change", "near_wall_share"),
)
"""Measures of a drive that are averaged, as far as it has them."""
TRAJECTORY = ("poses", "ranges", "actions", "speeds")
CONFIDENCE = 0.95
LEAST_KM = 1e-3
"""By which a count of collisions is divided at least: a car may stand still."""

Interval = tuple[float, float]


@dataclass(frozen=True)
class DrivingStyle:
    """A measure of how a car was driven, which some drives have.

    Attributes:
        key: its name among a drive's measures.
        name: for readers.
        form: how a value is written.
    """

    key: str
    name: str
    form: str

    def written(self, drive: Mapping[str, Any]) -> str:
        """The value of a drive's measures, "-" if there is none."""
        return f"{drive[self.key]:{self.form}}" if self.key in drive else "-"


BY_NAME = (
    DrivingStyle("forward_share", "forward share", ".0%"),
    DrivingStyle("switches_per_100m", "switches / 100 m", ".1f"),
    DrivingStyle("reversals", "reversals", "d"),
)
"""Where actions have names."""
BY_NUMBER = (
    DrivingStyle("mean_speed", "mean speed, m/s", ".1f"),
    DrivingStyle("steering_change", "steering change", ".3f"),
)
"""Where speed varies, and where actions are numbers."""


def styles_of(drives: Iterable[Mapping[str, Any]]) -> tuple[DrivingStyle, ...]:
    """Those that any of the drives' measures have; `BY_NAME` of none."""
    keys = {key for drive in drives for key in drive}
    return tuple(style for style in (*BY_NAME, *BY_NUMBER) if style.key in keys) or BY_NAME


@dataclass(frozen=True)
class Rollout:
    """One car's drive: until the lap is complete, it touches a wall, or the time is up.

    Attributes:
        start: station of the start, m along the centreline from the start line.
        lap_completed: all gates passed in order.
        collided: it touched a wall.
        progress: share of the lap driven, in [0, 1].
        lap_reward: sum of the paper's rewards; where nothing is paid for gates, of all rewards.
        steering_reward: sum of what turns and switches earn beside it.
        lap_steps: steps driven.
        forward_share: share of the steps with the action forward; None where actions are numbers, as are the next two.
        switches_per_100m: how often the action changed, per 100 m driven.
        reversals: how often left followed right or right followed left, without a step forward between.
        near_wall_share: share of the steps with a sensor below the reward's proximity threshold; None without one.
        poses: before each step and after the last, [T + 1, 3]; empty where the trajectory was not kept, as are the
            next two.
        ranges: at each pose, [T + 1, R], m.
        actions: [T], or [T, C] where they are numbers.
        steering_change: mean |change of the control `steer`| in a step; None unless actions are numbers.
        mean_speed: m/s; None of a car whose speed never varies, as are the next two.
        distance: driven, m.
        speeds: at each pose, [T + 1], m/s.
    """

    start: float
    lap_completed: bool
    collided: bool
    progress: float
    lap_reward: float
    steering_reward: float
    lap_steps: int
    forward_share: float | None
    switches_per_100m: float | None
    reversals: int | None
    near_wall_share: float | None
    poses: np.ndarray = field(repr=False)
    ranges: np.ndarray = field(repr=False)
    actions: np.ndarray = field(repr=False)
    steering_change: float | None = None
    mean_speed: float | None = None
    distance: float | None = None
    speeds: np.ndarray | None = field(default=None, repr=False)

    def measures(self) -> dict[str, Any]:
        """The figures without the trajectory, ready for JSON."""
        return {name: value for name, value in vars(self).items() if name not in TRAJECTORY and value is not None}

    def with_trajectory(self, kept: bool) -> "Rollout":
        """The same with a trajectory of its own, or without one: no more memory than that is held."""
        end, arrays = None if kept else 0, {name: getattr(self, name) for name in TRAJECTORY}
        return replace(self, **{name: array[:end].copy() for name, array in arrays.items() if array is not None})

    def state_dict(self) -> dict[str, Any]:
        """All of it, arrays as tensors."""
        return {
            name: torch.as_tensor(value) if isinstance(value, np.ndarray) else value
            for name, value in vars(self).items()
        }

    @classmethod
    def from_state_dict(cls, state: dict[str, Any]) -> "Rollout":
        """What `state_dict` told of.

        Raises:
            ValueError: it is no such state.
        """
        every = fields(cls)
        needed = {each.name for each in every if each.default is MISSING}  # older states lack the others
        if not isinstance(state, dict) or not needed <= state.keys() <= {each.name for each in every}:
            raise ValueError("a drive lacks some of its measures, or has others")
        values: dict[str, Any] = {
            name: value.numpy() if isinstance(value, Tensor) else value for name, value in state.items()
        }
        return cls(**values)


@dataclass(frozen=True)
class EvaluationResult:
    """Drives of one network.

    Attributes:
        rollouts: one for each circuit, in the order of `Circuits.validation`, and each start there.
    """

    rollouts: tuple[Rollout, ...]

    @property
    def laps_completed(self) -> int:
        """How many drives completed the lap."""
        return sum(drive.lap_completed for drive in self.rollouts)

    @property
    def lap_completed(self) -> bool:
        """Whether every one did."""
        return self.laps_completed == len(self.rollouts)

    @property
    def shown(self) -> int:
        """Which drive to look at: the first one of those with the least progress."""
        return min(range(len(self.rollouts)), key=lambda index: self.rollouts[index].progress)

    def with_trajectory(self, kept: bool) -> "EvaluationResult":
        """The same with the trajectory of the drive to look at, or without any."""
        shown = self.shown if kept else None
        return EvaluationResult(
            tuple(drive.with_trajectory(index == shown) for index, drive in enumerate(self.rollouts))
        )

    @property
    def quality(self) -> tuple[float, ...]:
        """Orders trials: by complete laps, progress, reward and how they steer; of a car whose speed varies by that."""
        first = self.rollouts[0]
        others: tuple[str, ...] = ("progress", "lap_reward", "steering_reward", "forward_share")
        if first.mean_speed is not None:
            others = ("progress", "mean_speed")
        elif first.forward_share is None:
            others = others[:-1]
        return (self.laps_completed, *(self._mean(name) for name in others))

    def measures(self) -> dict[str, Any]:
        """The figures, ready for JSON: of several drives the means, of counts rounded, and how many are laps."""
        first, *others = (drive.measures() for drive in self.rollouts)
        if not others:
            return first
        means = {name: self._mean(name) for name in first}
        return {
            **means,
            **{name: round(means[name]) for name in ("lap_steps", "reversals") if name in means},
            "lap_completed": self.lap_completed,
            "collided": any(drive.collided for drive in self.rollouts),
            "drives": len(self.rollouts),
            "laps_completed": self.laps_completed,
        }

    def state_dict(self) -> list[dict[str, Any]]:
        """All of it, arrays as tensors."""
        return [drive.state_dict() for drive in self.rollouts]

    @classmethod
    def from_state_dict(cls, state: list[dict[str, Any]]) -> "EvaluationResult":
        """What `state_dict` told of."""
        return cls(tuple(map(Rollout.from_state_dict, state)))

    def _mean(self, name: str) -> float:
        return math.fsum(getattr(drive, name) for drive in self.rollouts) / len(self.rollouts)


def aggregate(runs: Sequence[Sequence[Rollout]], step_length: float) -> dict[str, Any]:
    """The figures of the drives of one or more runs, ready for JSON.

    The interval of the share of completed laps is Wilson's and that of the collisions per km is the exact one of a
    Poisson rate, both over all drives; that of a mean is Student's, over the runs' means if there are several runs and
    over the drives if there is one.

    Args:
        runs: the drives of each run, at least one of each.
        step_length: metres that a car drives in a step, if its speed never varies.
    """
    drives = [drive for run in runs for drive in run]
    laps, collisions = sum(drive.lap_completed for drive in drives), sum(drive.collided for drive in drives)
    steps = sum(drive.lap_steps for drive in drives if drive.distance is None)
    driven_km = (steps * step_length + math.fsum(drive.distance or 0.0 for drive in drives)) / 1000
    means = [name for name in MEANS if getattr(drives[0], name) is not None]
    groups = runs if len(runs) > 1 else [[drive] for drive in drives]
    return {
        "starts": len(drives),
        "laps_completed": laps,
        **{name: _mean(drives, name) for name in means},
        "collisions": collisions,
        "driven_km": driven_km,
        "collisions_per_km": collisions / max(driven_km, LEAST_KM),
        "intervals": {
            "completion": share_interval(laps, len(drives)),
            "collisions_per_km": rate_interval(collisions, max(driven_km, LEAST_KM)),
            **{name: mean_interval([_mean(group, name) for group in groups]) for name in means},
        },
    }


def _mean(drives: Sequence[Rollout], name: str) -> float:
    return math.fsum(getattr(drive, name) for drive in drives) / len(drives)


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
