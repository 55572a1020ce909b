"""How well a run does, in one number, at its end and on the way there."""

from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple

from carrl.train.agent_run import AgentRun

Direction = Literal["minimize", "maximize"]


class Objective(NamedTuple):
    """What is sought.

    Attributes:
        direction: of better values.
        of_run: the value of one agent's run so far, given the frames that it may have in all.
        settles: whether a run's value is final once its first lap is confirmed.
    """

    direction: Direction
    of_run: Callable[[AgentRun, int], float]
    settles: bool

    def value(self, runs: Sequence[AgentRun], frames: int) -> float:
        """The mean over agents trained side by side."""
        return sum(self.of_run(run, frames) for run in runs) / len(runs)

    def is_settled(self, runs: Sequence[AgentRun]) -> bool:
        """Whether more training cannot change the value."""
        return self.settles and all(run.first_lap is not None for run in runs)


def _frames_to_lap(run: AgentRun, frames: int) -> float:
    """Env steps before the first greedy lap; without a confirmed one, as if it needed up to twice the run's length."""
    if run.first_lap is not None:
        return float(run.first_lap.frame)
    return frames * (2.0 - (run.best.measures()["progress"] if run.best else 0.0))


def _drive_quality(run: AgentRun, _: int) -> float:
    """Progress of the best greedy drive; of one that laps, also its share of steps forward and away from walls."""
    if run.best is None:
        return 0.0
    best = run.best.measures()
    steering = best["forward_share"] + 1.0 - best["near_wall_share"]
    return float(best["progress"] + (steering if best["lap_completed"] else 0.0))


OBJECTIVES = {
    "first_lap": Objective("minimize", _frames_to_lap, settles=True),
    "drive": Objective("maximize", _drive_quality, settles=False),
}
