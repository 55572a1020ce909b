"""What a search for settings may be after; nothing here waits for torch."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Literal, NamedTuple

if TYPE_CHECKING:
    from carrl.train.replicate_run import ReplicateRun


NO_LAP_S = 3600.0
"""What a lap that does not count is taken for, s, and as much again in proportion to what is missing of it."""


class Objective(NamedTuple):
    """What a search for settings is after, in one number, at a run's end and on the way there.

    Attributes:
        direction: of better values.
        of_run: the value of one replicate's run so far, given the frames that it may have in all.
        settles: whether a run's value is final once its first lap is confirmed.
    """

    direction: Literal["minimize", "maximize"]
    of_run: Callable[["ReplicateRun", int], float]
    settles: bool

    def value(self, runs: Sequence["ReplicateRun"], frames: int) -> float:
        """The mean over replicates trained side by side."""
        return sum(self.of_run(run, frames) for run in runs) / len(runs)

    def is_settled(self, runs: Sequence["ReplicateRun"]) -> bool:
        """Whether more training cannot change the value."""
        return self.settles and all(run.first_lap is not None for run in runs)


def _frames_to_lap(run: "ReplicateRun", frames: int) -> float:
    """Env steps before the first greedy lap; without a confirmed one, as if it needed up to twice the run's length."""
    if run.first_lap is not None:
        return float(run.first_lap.frame)
    return frames * (2.0 - (run.best.measures()["progress"] if run.best else 0.0))


def _drive_quality(run: "ReplicateRun", _: int) -> float:
    """Progress of the best greedy drive; of one that laps, also its share of steps forward and away from walls.

    Of a car whose speed varies a lap counts one more, and by its mean speed in hundreds of m/s.
    """
    if run.best is None:
        return 0.0
    best = run.best.measures()
    if "mean_speed" in best:
        return float(best["progress"] + (1.0 + best["mean_speed"] / 100 if best["lap_completed"] else 0.0))
    steering = best.get("forward_share", 0.0) + 1.0 - best.get("near_wall_share", 0.0)
    return float(best["progress"] + (steering if best["lap_completed"] else 0.0))


def _lap_time(run: "ReplicateRun", _: int) -> float:
    """Mean lap time of the best evaluation, s; a lap that does not count takes an hour or two."""
    if run.best is None:
        return 2 * NO_LAP_S
    drives = run.best.rollouts
    times = [NO_LAP_S * (2 - min(each.progress, 1.0)) if each.lap_time is None else each.lap_time for each in drives]
    return sum(times) / len(times)


OBJECTIVES = {
    "first_lap": Objective("minimize", _frames_to_lap, settles=True),
    "drive": Objective("maximize", _drive_quality, settles=False),
    "lap_time": Objective("minimize", _lap_time, settles=False),
}
