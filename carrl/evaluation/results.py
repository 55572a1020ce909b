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

from carrl.evaluation.intervals import mean_interval, rate_interval, share_interval
from carrl.evaluation.lap_timing import SectorTimes
from carrl.racing import SECTORS

MEANS = (
    *("progress", "lap_reward", "lap_steps", "forward_share", "switches_per_100m"),
    *("mean_speed", "steering_change", "grip_mean", "near_wall_share"),
)
"""Measures of a drive that are averaged, as far as it has them."""
TRAJECTORY = ("poses", "ranges", "actions", "speeds", "others")
DECIMALS = 3
"""Of lap times for machines, s."""
LEAST_KM, LEAST_LAPS = 1e-3, 1e-6
"""By which counts are divided at least: a car may stand still."""


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
        return "-" if drive.get(self.key) is None else f"{drive[self.key]:{self.form}}"


LAP_TIME = DrivingStyle("lap_time", "lap, s", ".2f")
"""Of every car, but for drives of older versions."""
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
    """Those that any of the drives' measures have, the lap time first; `BY_NAME` of none."""
    keys = {key for drive in drives for key in drive}
    return tuple(style for style in (LAP_TIME, *BY_NAME, *BY_NUMBER) if style.key in keys) or BY_NAME


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
        others: poses of the other cars of the world at each pose, [T + 1, M, 3]; None of a car that is alone.
        grip_mean: of the tyres, the share of the limit of grip used, mu g, over the steps; None where it is not known,
            as is the next one.
        grip_greatest: the greatest of these shares.
        overtakes: places won from other cars; None of a car that is alone, as are the next four.
        places_won: the same less the places lost.
        contacts_own: with other cars, into which it drove with its front.
        contacts_others: with other cars otherwise.
        lap_share: how much of a lap the steps are.
        sector_times: of each lap that was begun, see `carrl.evaluation.lap_timing`; a lap with all three counts.
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
    others: np.ndarray | None = field(default=None, repr=False)
    grip_mean: float | None = None
    grip_greatest: float | None = None
    overtakes: int | None = None
    places_won: int | None = None
    contacts_own: int | None = None
    contacts_others: int | None = None
    lap_share: float | None = None
    sector_times: SectorTimes = ()

    @property
    def lap_times(self) -> tuple[float, ...]:
        """Of the laps that count, in order, s."""
        return tuple(math.fsum(sectors) for sectors in self.sector_times if len(sectors) == SECTORS)

    @property
    def lap_time(self) -> float | None:
        """Of the lap that is measured, s; None if it does not count, as where the car touched a wall."""
        counts = self.lap_completed and self.sector_times and len(self.sector_times[-1]) == SECTORS
        return self.lap_times[-1] if counts else None

    @property
    def is_clean_lap(self) -> bool:
        """Whether the lap is complete without contact with a wall or, where there are others, a car."""
        return self.lap_completed and not (self.collided or self.contacts_own or self.contacts_others)

    @property
    def standing_laps(self) -> int:
        """How many laps began at rest: the first one of a car whose speed varies."""
        return int(self.mean_speed is not None)

    def measures(self) -> dict[str, Any]:
        """The figures without the trajectory and the sectors, ready for JSON."""
        left_out = (*TRAJECTORY, "sector_times")
        figures = {name: value for name, value in vars(self).items() if name not in left_out and value is not None}
        return figures | {"lap_time": rounded(self.lap_time)}

    def laps(self) -> list[dict[str, Any]]:
        """Each lap that was begun, ready for JSON; the time of one that does not count is None."""
        return [
            {
                "lap": number,
                "start": "standing" if number <= self.standing_laps else "flying",
                "time_s": rounded(math.fsum(sectors)) if len(sectors) == SECTORS else None,
                "sectors_s": [rounded(sector) for sector in sectors],
            }
            for number, sectors in enumerate(self.sector_times, start=1)
        ]

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
        """Orders trials: by complete laps, progress, reward, how they steer, and the lower mean lap time.

        Of a car whose speed varies the faster laps are better where as many are complete and progress is the same: the
        lower mean lap time, and where none counts the greater mean speed.
        """
        first = self.rollouts[0]
        pace = -math.inf if self.lap_time is None else -self.lap_time
        if first.mean_speed is not None:
            return self.laps_completed, self._mean("progress"), pace, self._mean("mean_speed")
        earned = tuple(map(self._mean, ("progress", "lap_reward", "steering_reward")))
        forward = () if first.forward_share is None else (self._mean("forward_share"),)
        return self.laps_completed, *earned, pace, *forward

    @property
    def lap_time(self) -> float | None:
        """Mean of the laps that count, s; None if none does."""
        return mean_or_none(self._lap_times)

    @property
    def _lap_times(self) -> list[float]:
        return [drive.lap_time for drive in self.rollouts if drive.lap_time is not None]

    def measures(self) -> dict[str, Any]:
        """The figures, ready for JSON: of several drives the means, of counts rounded, and how many are laps."""
        first, *others = (drive.measures() for drive in self.rollouts)
        if not others:
            return first
        means = {name: self._mean(name) for name in first if name != "lap_time"}
        return {
            **means,
            **{name: round(means[name]) for name in ("lap_steps", "reversals") if name in means},
            **_greatest_grip(self.rollouts),
            "lap_time": rounded(self.lap_time),
            "best_lap_time": rounded(min(self._lap_times, default=None)),
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
    traffic, traffic_intervals = _among_others(drives, max(driven_km, LEAST_KM))
    means = [name for name in MEANS if getattr(drives[0], name) is not None]
    groups = runs if len(runs) > 1 else [[drive] for drive in drives]
    return {
        "starts": len(drives),
        "laps_completed": laps,
        **{name: _mean(drives, name) for name in means},
        **_greatest_grip(drives),
        "collisions": collisions,
        "driven_km": driven_km,
        "collisions_per_km": collisions / max(driven_km, LEAST_KM),
        **traffic,
        "intervals": {
            "completion": share_interval(laps, len(drives)),
            "collisions_per_km": rate_interval(collisions, max(driven_km, LEAST_KM)),
            **traffic_intervals,
            **{name: mean_interval([_mean(group, name) for group in groups]) for name in means},
        },
    }


def _among_others(drives: Sequence[Rollout], driven_km: float) -> tuple[dict[str, Any], dict[str, Any]]:
    """What happened between the car and others, and intervals of that; nothing of a car that was alone."""
    if drives[0].overtakes is None:
        return {}, {}
    laps = math.fsum(drive.lap_share or 0.0 for drive in drives)
    contacts = {
        f"contacts_{fault}": sum(getattr(drive, f"contacts_{fault}") for drive in drives) for fault in ("own", "others")
    }
    figures = {
        "overtakes": sum(drive.overtakes or 0 for drive in drives),
        "overtakes_per_lap": sum(drive.overtakes or 0 for drive in drives) / max(laps, LEAST_LAPS),
        "places_won": _mean(drives, "places_won"),
        "clean_laps": sum(drive.is_clean_lap for drive in drives),
    }
    for name, count in contacts.items():
        figures |= {name: count, f"{name}_per_km": count / driven_km}
    return figures, {f"{name}_per_km": rate_interval(count, driven_km) for name, count in contacts.items()}


def _greatest_grip(drives: Sequence[Rollout]) -> dict[str, float]:
    shares = [drive.grip_greatest for drive in drives if drive.grip_greatest is not None]
    return {"grip_greatest": max(shares)} if shares else {}


def mean_or_none(values: Sequence[float]) -> float | None:
    """The mean; None of no values."""
    return math.fsum(values) / len(values) if values else None


def rounded(time: float | None) -> float | None:
    """A time as machines are told it."""
    return None if time is None else round(time, DECIMALS)


def _mean(drives: Sequence[Rollout], name: str) -> float:
    return math.fsum(getattr(drive, name) for drive in drives) / len(drives)
