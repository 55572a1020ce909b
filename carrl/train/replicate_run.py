"""What one replicate's training run has come to, kept in memory and in its folder; how well it does, in figures."""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from torch import nn

from carrl.evaluation.results import EvaluationResult
from carrl.log.messages import Episode
from carrl.train.checkpoint import check_fits
from carrl.train.folder import RunFolder

RECENT_EPISODES = 20
"""The paper averages returns over this many episodes (figure 3)."""
EVALUATION_KEYS = (
    "lap_completed",
    "lap_reward",
    "lap_steps",
    "lap_time",
    "best_lap_time",
    "forward_share",
    "switches_per_100m",
    "reversals",
    "mean_speed",
    "steering_change",
    "grip_mean",
    "grip_greatest",
    "near_wall_share",
    "progress",
    "overtakes",
    "places_won",
    "contacts_own",
    "contacts_others",
    "drives",
    "laps_completed",
)
"""What `summary.json` has of an evaluation; of several drives the means, the best lap time, and the last two besides.
Lap times are in seconds; None if no lap counts."""


@dataclass(frozen=True)
class TrainingStatus:
    """Where the training of a replicate stands.

    Attributes:
        frames: env steps done.
        updates: of its networks.
        loss: before the last update; nan if there was none.
        wall_time_s: since training began, s.
        figures: the algorithm's own, such as epsilon.
    """

    frames: int = 0
    updates: int = 0
    loss: float = math.nan
    wall_time_s: float = 0.0
    figures: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class FirstLap:
    """When the greedy policy first completed its lap, or those of all circuits at once, and did so again.

    That is after how many ended episodes, env steps and seconds. A network that has made no update laps by luck alone,
    and one that has learnt little may lap once in passing; so a lap counts only if the network has been updated and
    the next evaluation completes the lap as well. The figures are those of the first of the two.
    """

    episode: int
    frame: int
    wall_time_s: float


class ReplicateRun:
    """One replicate's episodes and evaluations.

    Args:
        seed: of the replicate.
        network: that checkpoints keep.
        folder: for what it comes to.

    Attributes:
        status: the latest that it was told; that of its end once it is over.
        first_lap: None until it is confirmed.
        best: its best evaluation, with the trajectory that `lap.png` shows.
        last: its latest evaluation, without trajectories.
    """

    def __init__(self, seed: int, network: nn.Module, folder: RunFolder) -> None:
        """Begins with nothing done."""
        self.seed, self.network, self.folder = seed, network, folder
        self.status = TrainingStatus()
        self.episode_returns: list[float] = []
        self._recent_returns: deque[float] = deque(maxlen=RECENT_EPISODES)
        self.laps = 0
        self.first_lap: FirstLap | None = None
        self._unconfirmed_lap: FirstLap | None = None
        self.best: EvaluationResult | None = None
        self.last: EvaluationResult | None = None
        self._checkpoints: dict[str, dict[str, Any]] = {}

    def state_dict(self) -> dict[str, Any]:
        """All that was noted so far."""
        return {
            "status": asdict(self.status),
            "episode_returns": self.episode_returns,
            "laps": self.laps,
            "first_lap": asdict(self.first_lap) if self.first_lap else None,
            "unconfirmed_lap": asdict(self._unconfirmed_lap) if self._unconfirmed_lap else None,
            "best": self.best.state_dict() if self.best else None,
            "last": self.last.state_dict() if self.last else None,
            "checkpoints": self._checkpoints,
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Goes on from there; the folder's checkpoints become again what they were.

        Raises:
            ValueError: there is a lap or an evaluation that is none.
        """
        self.status = TrainingStatus(**state["status"])
        self.episode_returns = list(state["episode_returns"])
        self._recent_returns.extend(self.episode_returns[-RECENT_EPISODES:])
        self.laps = state["laps"]
        self.first_lap, self._unconfirmed_lap = map(_lap_of, (state["first_lap"], state["unconfirmed_lap"]))
        self.best, self.last = (
            EvaluationResult.from_state_dict(state[name]) if state[name] else None for name in ("best", "last")
        )
        self._checkpoints = dict(state["checkpoints"])
        for name, checkpoint in self._checkpoints.items():
            self.folder.save_checkpoint(name, checkpoint)

    @property
    def episodes(self) -> int:
        """Episodes ended."""
        return len(self.episode_returns)

    @property
    def recent_return(self) -> float:
        """Mean return of the last 20 episodes; nan before the first has ended."""
        return sum(self._recent_returns) / len(self._recent_returns) if self._recent_returns else math.nan

    def add_episodes(self, ended: Sequence[Episode], status: TrainingStatus) -> None:
        """Notes where training stands, and the episodes that ended."""
        self.status = status
        for episode in ended:
            self.episode_returns.append(episode.episode_return)
            self._recent_returns.append(episode.episode_return)
            self.laps += episode.laps
            own = {
                "mean_return_20": round(self.recent_return, 3),
                **{name: round(value, 6) for name, value in status.figures.items()},
                "loss": status.loss,
                "updates": status.updates,
                "wall_time_s": round(status.wall_time_s, 3),
            }
            self.folder.add_episode(episode, own)

    def add_evaluation(self, evaluation: EvaluationResult, status: TrainingStatus) -> None:
        """Notes drives without exploration, and keeps the network that drove them and the best one so far."""
        self.status = status
        self.last = evaluation.with_trajectory(False)
        if self.first_lap is None:
            self._seek_first_lap(evaluation, status)
        self.folder.add_evaluation(evaluation.measures(), status.frames, self.episodes)
        self.keep_network("last")
        if self.best is None or evaluation.quality > self.best.quality:
            self.best = evaluation.with_trajectory(True)
            self.keep_network("best")

    def _seek_first_lap(self, evaluation: EvaluationResult, status: TrainingStatus) -> None:
        """Confirms the lap of the evaluation before this one, or forgets it and takes note of this one's."""
        if not evaluation.lap_completed:
            self._unconfirmed_lap = None
        elif self._unconfirmed_lap is not None:
            self.first_lap, self._unconfirmed_lap = self._unconfirmed_lap, None
        elif status.updates > 0:
            self._unconfirmed_lap = FirstLap(self.episodes, status.frames, status.wall_time_s)

    def keep_network(self, name: str) -> None:
        """Writes the network as it is now into `checkpoints/NAME.pt`."""
        network = {key: value.clone() for key, value in self.network.state_dict().items()}
        self._checkpoints[name] = {"network": network, "frames": self.status.frames, "episodes": self.episodes}
        self.folder.save_checkpoint(name, self._checkpoints[name])

    def summary(self) -> dict[str, Any]:
        """Its figures; `evaluation` is of the best greedy drive, whose policy is `checkpoints/best.pt`."""
        return {
            "episodes": self.episodes,
            "frames": self.status.frames,
            "updates": self.status.updates,
            "wall_time_s": round(self.status.wall_time_s, 3),
            "first_lap": asdict(self.first_lap) if self.first_lap else None,
            "evaluation": _figures(self.best),
            "last_evaluation": _figures(self.last),
        }


def _lap_of(state: Any) -> FirstLap | None:
    if state is None:
        return None
    check_fits(state, asdict(FirstLap(0, 0, 0.0)), "a lap")
    return FirstLap(**state)


def _figures(evaluation: EvaluationResult | None) -> dict[str, Any] | None:
    if evaluation is None:
        return None
    measures = evaluation.measures()
    return {key: measures[key] for key in EVALUATION_KEYS if key in measures}
