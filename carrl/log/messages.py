"""The small messages of a log: one for each ended episode, and one now and then about the learning."""

from collections.abc import Mapping
from typing import Literal, NamedTuple

Ended = Literal["collision", "time limit", "other end"]


def how_ended(terminated: bool, collided: bool) -> Ended:
    """Why an episode ended: at a wall, by another end of its task, or else because its time was up."""
    if not terminated:
        return "time limit"
    return "collision" if collided else "other end"


class Episode(NamedTuple):
    """One episode that has ended.

    Attributes:
        episode: its number in the run, from 0, in the order in which episodes began.
        env: which car of the run drove it.
        track: index of the track it was driven on, among the attached ones.
        frame: env steps of the whole run when it ended.
        begin_ns: simulated time at which it began, since the start of the run, ns.
        end_ns: simulated time at which it ended, ns.
        episode_return: undiscounted sum of its rewards.
        length: its steps.
        gates: gates passed.
        laps: complete laps, each of all gates.
        ended: why, "collision", "time limit" or "other end", such as no progress or running backwards.
        end_pose: where: x m, y m, heading rad.
    """

    episode: int
    env: int
    track: int
    frame: int
    begin_ns: int
    end_ns: int
    episode_return: float
    length: int
    gates: int
    laps: int
    ended: Ended
    end_pose: tuple[float, float, float]


class Metrics(NamedTuple):
    """How learning goes, every half second or so.

    Attributes:
        frame: env steps of the run.
        updates: of the network.
        loss: before the last update; nan if there was none.
        frames_per_second: env steps per second of wall time since the last such message.
        figures: what the algorithm measured on the transitions logged just before, by name, such as `td_error`.
    """

    frame: int
    updates: int
    loss: float
    frames_per_second: float
    figures: Mapping[str, float]

    def row(self) -> dict[str, float]:
        """All of it, by name."""
        given = self._asdict()
        return {**{name: given[name] for name in self._fields[:-1]}, **self.figures}


class MetricsFields(NamedTuple):
    """The fields of a message of `Metrics` in a file.

    Those that DQN measures have fields of their own, which logs had before there were others, too. Where there are
    other figures, none of these three is one of them, and all are listed by name instead.
    """

    frame: int
    updates: int
    loss: float
    td_error: float
    action_value: float
    epsilon: float
    frames_per_second: float
    figure_names: tuple[str, ...]
    figures: tuple[float, ...]

    @staticmethod
    def of(metrics: Metrics) -> "MetricsFields":
        """Those of this message."""
        given, names = metrics.figures, tuple(metrics.figures)
        own = dict.fromkeys(DQN_FIGURES, 0.0)
        if names == DQN_FIGURES:
            own, given = dict(given), {}
        return MetricsFields(
            metrics.frame,
            metrics.updates,
            metrics.loss,
            **own,
            frames_per_second=metrics.frames_per_second,
            figure_names=tuple(given),
            figures=tuple(given.values()),
        )

    def message(self) -> Metrics:
        """What they say.

        Raises:
            ValueError: there are not as many names as figures, or a name is there twice.
        """
        if len(set(self.figure_names)) != len(self.figures) or len(self.figure_names) != len(self.figures):
            raise ValueError(f"metrics have {len(self.figures)} figures with {len(set(self.figure_names))} names")
        figures = dict(zip(self.figure_names, self.figures, strict=True))
        own = {name: getattr(self, name) for name in DQN_FIGURES}
        return Metrics(self.frame, self.updates, self.loss, self.frames_per_second, figures or own)


DQN_FIGURES = ("td_error", "action_value", "epsilon")
"""Mean absolute TD error, mean Q-value of the actions chosen, and probability of a random action in the next step."""
