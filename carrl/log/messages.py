"""The small messages of a log: one for each ended episode, and one now and then about the learning."""

from typing import Literal, NamedTuple

Ended = Literal["collision", "time limit"]


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
        ended: why, "collision" or "time limit".
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
        td_error: mean absolute TD error of the transitions logged just before.
        action_value: mean Q-value of the actions chosen in them.
        epsilon: probability of a random action in the next step.
        frames_per_second: env steps per second of wall time since the last such message.
    """

    frame: int
    updates: int
    loss: float
    td_error: float
    action_value: float
    epsilon: float
    frames_per_second: float
