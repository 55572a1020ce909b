"""What viewers plot and list: a named field for each number, and what happened in words.

Shapes: `T` steps, `R` rays, `A` actions, `K` terms of the reward.
"""

from collections.abc import Iterator

import numpy as np
from foxglove.messages import Log, LogLevel

from carrl.export.foxglove.entry import Entry, stamp, times_ns
from carrl.export.foxglove.message_type import MessageType, identifiers
from carrl.log.scene import Floats
from carrl.log.trace import EpisodeTrace
from carrl.render.episode_events import direction, episode_events

LEVELS = {"info": LogLevel.Info, "warning": LogLevel.Warning, "error": LogLevel.Error}


def plot_entries(trace: EpisodeTrace) -> Iterator[Entry]:
    """Yields all messages that are plotted or listed."""
    scene = trace.scene
    yield from _numbers(trace, "/q_values", "QValues", list(scene.action_names), trace.action_values)
    rewards = np.column_stack([trace.rewards, trace.rewards.cumsum(), trace.reward_terms])
    yield from _numbers(trace, "/reward", "Reward", ["reward", "return_so_far", *scene.reward_terms], rewards)
    yield from _numbers(trace, "/ranges", "Ranges", [_ray_name(angle) for angle in scene.sensor_angles], trace.ranges)
    yield from _numbers(trace, "/epsilon", "Epsilon", ["epsilon"], trace.epsilon[:, None])
    yield from _actions(trace)
    yield from _events(trace)


def _numbers(trace: EpisodeTrace, topic: str, kind: str, names: list[str], rows: Floats) -> Iterator[Entry]:
    """A message for each row, [T or T + 1, N], with a field for each of the N names."""
    message = MessageType(kind, identifiers(names))
    for time_ns, row in zip(times_ns(trace), rows.tolist(), strict=False):
        yield Entry(time_ns, topic, message.schema, message.encode(*row))


def _actions(trace: EpisodeTrace) -> Iterator[Entry]:
    """What was done at each step, and whether by chance, each by name."""
    message = MessageType("Action", action=trace.scene.action_names, choice=("greedy", "random"))
    for time_ns, action, drawn in zip(times_ns(trace), trace.actions, trace.exploratory, strict=False):
        yield Entry(time_ns, "/action", message.schema, message.encode(int(action), int(drawn)))


def _events(trace: EpisodeTrace) -> Iterator[Entry]:
    times = times_ns(trace)
    for event in episode_events(trace):
        time_ns = times[event.row]
        line = Log(timestamp=stamp(time_ns), level=LEVELS[event.level], message=event.text, name="carrl")
        yield Entry.of(time_ns, "/events", line)


def _ray_name(angle: float) -> str:
    """The direction of a ray, rad, as the name of a field: ahead, left_30, right_90."""
    return "_".join(reversed(direction(angle).replace("°", "").split()))
