"""What one agent's training run has come to, kept in memory and in its folder."""

import math
from collections import deque
from dataclasses import asdict, dataclass
from typing import Any

from carrl.evaluation.results import Trial
from carrl.log.messages import Episode
from carrl.train.folder import RunFolder
from carrl.train.learner import Agent
from carrl.train.moment import Moment

RECENT_EPISODES = 20
"""The paper averages returns over this many episodes (figure 3)."""


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


class AgentRun:
    """One agent's episodes and greedy drives.

    Attributes:
        moment: the latest that it was told of; that of its end once it is over.
        first_lap: None until it is confirmed.
    """

    def __init__(self, agent: Agent, folder: RunFolder) -> None:
        """Begins with nothing done."""
        self.agent, self.folder = agent, folder
        self.moment = Moment(0, 0, math.nan, math.nan, 0.0)
        self.episode_returns: list[float] = []
        self._recent_returns: deque[float] = deque(maxlen=RECENT_EPISODES)
        self.laps = 0
        self.first_lap: FirstLap | None = None
        self._unconfirmed_lap: FirstLap | None = None
        self.best: Trial | None = None
        self.last: Trial | None = None
        self._checkpoints: dict[str, dict[str, Any]] = {}

    def state_dict(self) -> dict[str, Any]:
        """All that was noted so far."""
        return {
            "moment": asdict(self.moment),
            "episode_returns": self.episode_returns,
            "laps": self.laps,
            "first_lap": asdict(self.first_lap) if self.first_lap else None,
            "unconfirmed_lap": asdict(self._unconfirmed_lap) if self._unconfirmed_lap else None,
            "best": self.best.state_dict() if self.best else None,
            "last": self.last.state_dict() if self.last else None,
            "checkpoints": self._checkpoints,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Goes on from there; the folder's checkpoints become again what they were."""
        self.moment = Moment(**state["moment"])
        self.episode_returns = list(state["episode_returns"])
        self._recent_returns.extend(self.episode_returns[-RECENT_EPISODES:])
        self.laps = state["laps"]
        self.first_lap, self._unconfirmed_lap = (
            FirstLap(**state[name]) if state.get(name) else None  # older versions confirmed no lap
            for name in ("first_lap", "unconfirmed_lap")
        )
        self.best, self.last = (
            Trial.from_state_dict(state[name]) if state[name] else None for name in ("best", "last")
        )
        self._checkpoints = dict(state["checkpoints"])
        self.write_checkpoints()

    def write_checkpoints(self) -> None:
        """Writes the latest checkpoints to the folder once more."""
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

    def add_episodes(self, ended: list[Episode], moment: Moment) -> None:
        """Notes episodes that ended."""
        self.moment = moment
        for episode in ended:
            self.episode_returns.append(episode.episode_return)
            self._recent_returns.append(episode.episode_return)
            self.laps += episode.laps
            self.folder.add_episode(episode, self.recent_return, moment)

    def add_evaluation(self, attempt: Trial, moment: Moment) -> None:
        """Notes a trial without exploration, and keeps the network that drove it and the best one so far."""
        self.moment = moment
        self.last = attempt
        if self.first_lap is None:
            self._seek_first_lap(attempt, moment)
        self.folder.add_evaluation(attempt, moment.frames, self.episodes)
        self.keep_network("last", moment)
        if self.best is None or attempt.quality > self.best.quality:
            self.best = attempt
            self.keep_network("best", moment)

    def _seek_first_lap(self, attempt: Trial, moment: Moment) -> None:
        """Confirms the lap of the evaluation before this one, or forgets it and takes note of this one's."""
        if not attempt.lap_completed:
            self._unconfirmed_lap = None
        elif self._unconfirmed_lap is not None:
            self.first_lap, self._unconfirmed_lap = self._unconfirmed_lap, None
        elif moment.updates > 0:
            self._unconfirmed_lap = FirstLap(self.episodes, moment.frames, moment.wall_time_s)

    def keep_network(self, name: str, moment: Moment) -> None:
        """Writes the network as it is now into `checkpoints/NAME.pt`."""
        network = {key: value.clone() for key, value in self.agent.network.state_dict().items()}
        self._checkpoints[name] = {"network": network, "frames": moment.frames, "episodes": self.episodes}
        self.folder.save_checkpoint(name, self._checkpoints[name])
