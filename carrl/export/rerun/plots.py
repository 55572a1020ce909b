"""What is plotted over the steps beside the map, and what is told in words.

Shapes: `T` steps, `R` rays, `A` actions, `K` terms of the reward.
"""

from collections.abc import Sequence

import numpy as np
import rerun as rr

from carrl.export.rerun.step_stream import StepStream
from carrl.log.scene import Floats
from carrl.log.trace import EpisodeTrace
from carrl.render.episode_events import direction, episode_events
from carrl.render.viewer_palette import ACTIONS, ERROR, INFO, RAY, START, WARNING, Colour, action_colours, blend

LEVELS = {
    "info": (rr.TextLogLevel.INFO, INFO),
    "warning": (rr.TextLogLevel.WARN, WARNING),
    "error": (rr.TextLogLevel.ERROR, ERROR),
}
"""What Rerun calls each level of an event, and its colour."""
TERM_COLOURS = (ERROR, WARNING, RAY, ACTIONS[2])
"""Of collision, proximity, gate and steering; others begin again."""


def send_actions(stream: StepStream, trace: EpisodeTrace) -> None:
    """Sends each step's action, and whether it was drawn at random, as states by name."""
    names = trace.scene.action_names
    _send_states(stream, "action", [names[action] for action in trace.actions], names, action_colours(len(names)))
    choices = ("greedy", "random")
    _send_states(stream, "choice", [choices[int(drawn)] for drawn in trace.exploratory], choices, (INFO, WARNING))


def send_q_values(stream: StepStream, trace: EpisodeTrace) -> None:
    """Sends the Q-values from which each action was chosen, [T, A]."""
    names = trace.scene.action_names
    _send_series(stream, "q_values", trace.action_values, names, action_colours(len(names)))


def send_rewards(stream: StepStream, trace: EpisodeTrace) -> None:
    """Sends the reward of each step, [T], its terms, [T, K], and its sum so far."""
    names = trace.scene.reward_terms
    colours = [TERM_COLOURS[term % len(TERM_COLOURS)] for term in range(len(names))]
    values = np.column_stack([trace.rewards.cumsum(), trace.rewards, trace.reward_terms])
    _send_series(stream, "reward", values, ["return so far", "reward", *names], [INFO, START, *colours])


def send_ranges(stream: StepStream, trace: EpisodeTrace) -> None:
    """Sends what the rays read, [T + 1, R], m, coloured from blue on the right over green to red on the left."""
    angles = trace.scene.sensor_angles
    shares = np.linspace(-1, 1, len(angles)) if len(angles) > 1 else np.zeros(1)
    colours = [blend(RAY, ACTIONS[1] if share > 0 else ACTIONS[2], abs(share)) for share in shares]
    _send_series(stream, "ranges", trace.ranges, [direction(angle) for angle in angles], colours, width=1.0)


def send_epsilon(stream: StepStream, trace: EpisodeTrace) -> None:
    """Sends the probability of a random action, [T]."""
    _send_series(stream, "epsilon", trace.epsilon[:, None], ["epsilon"], [WARNING])


def send_events(stream: StepStream, trace: EpisodeTrace) -> None:
    """Sends what happened, in words."""
    events = episode_events(trace)
    columns = rr.TextLog.columns(
        text=[event.text for event in events],
        level=[LEVELS[event.level][0] for event in events],
        color=[LEVELS[event.level][1] for event in events],
    )
    stream.send("events", [event.row for event in events], columns)


def _send_series(
    stream: StepStream,
    path: str,
    values: Floats,
    names: Sequence[str],
    colours: Sequence[Colour],
    width: float = 1.5,
) -> None:
    """Sends a line for each column of the values, a row for each step."""
    style = rr.SeriesLines(names=list(names), colors=list(colours), widths=[width] * len(names))
    stream.send(path, range(len(values)), rr.Scalars.columns(scalars=values))
    stream.send_static(path, style)


def _send_states(
    stream: StepStream, path: str, states: Sequence[str], names: Sequence[str], colours: Sequence[Colour]
) -> None:
    """Sends the states, [T], where they change, and the colours of all that there are."""
    changes = [row for row, state in enumerate(states) if row == 0 or state != states[row - 1]]
    stream.send(path, changes, rr.StateChange.columns(state=[states[row] for row in changes]))
    style = rr.StateConfiguration(values=list(names), colors=list(colours))
    stream.send_static(path, style)
