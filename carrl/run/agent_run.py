"""What one agent's training run has come to, kept in memory and in its folder."""

import math
from collections import deque
from dataclasses import dataclass

from carrl.errors import CarrlError
from carrl.record.messages import Episode
from carrl.run.folder import RunFolder
from carrl.run.learner import Agent
from carrl.run.moment import Moment
from carrl.run.trial import Trial

RECENT_EPISODES = 20
"""The paper averages returns over this many episodes (figure 3)."""


@dataclass(frozen=True)
class FirstLap:
    """When the greedy policy first completed its lap, or those of all circuits at once.

    That is after how many ended episodes, env steps and seconds.
    """

    episode: int
    frame: int
    wall_time_s: float


class AgentRun:
    """One agent's episodes and greedy drives.

    Attributes:
        moment: the latest that it was told of; that of its end once it is over.
    """

    def __init__(self, agent: Agent, folder: RunFolder) -> None:
        """Begins with nothing done."""
        self.agent, self.folder = agent, folder
        self.moment = Moment(0, 0, math.nan, math.nan, 0.0)
        self.episode_returns: list[float] = []
        self._recent_returns: deque[float] = deque(maxlen=RECENT_EPISODES)
        self.laps = 0
        self.first_lap: FirstLap | None = None
        self.best: Trial | None = None
        self.last: Trial | None = None

    @property
    def episodes(self) -> int:
        """Episodes ended."""
        return len(self.episode_returns)

    @property
    def recent_return(self) -> float:
        """Mean return of the last 20 episodes; nan before the first has ended."""
        return sum(self._recent_returns) / len(self._recent_returns) if self._recent_returns else math.nan

    def add_episodes(self, ended: list[Episode], moment: Moment) -> None:
        """Notes episodes that ended.

        Raises:
            CarrlError: the loss is not a number, though there was an update.
        """
        self.moment = moment
        if ended and moment.updates and not math.isfinite(moment.loss):
            place = f"at frame {moment.frames} of seed {self.agent.seed}"
            raise CarrlError(f"the loss is {moment.loss} {place}; try a smaller optimizer.lr")
        for episode in ended:
            self.episode_returns.append(episode.episode_return)
            self._recent_returns.append(episode.episode_return)
            self.laps += episode.laps
            self.folder.add_episode(episode, self.recent_return, moment)

    def add_evaluation(self, attempt: Trial, moment: Moment) -> None:
        """Notes a trial without exploration, and keeps the network that drove it and the best one so far."""
        self.moment = moment
        self.last = attempt
        if attempt.lap_completed and self.first_lap is None:
            self.first_lap = FirstLap(self.episodes, moment.frames, moment.wall_time_s)
        self.folder.add_evaluation(attempt, moment.frames, self.episodes)
        network = {name: value.clone() for name, value in self.agent.network.state_dict().items()}
        state = {"network": network, "frames": moment.frames, "episodes": self.episodes}
        self.folder.save_checkpoint("last", state)
        if self.best is None or attempt.quality > self.best.quality:
            self.best = attempt
            self.folder.save_checkpoint("best", state)
