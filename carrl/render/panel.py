"""The right of a video's frame: what the network thought, what the car did and what it got for it, as figures and bars.

Shapes: `T` steps, `A` actions. Every part begins at a height `y` and returns where it ends, px.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from carrl.log.scene import Floats
from carrl.log.trace import EpisodeTrace
from carrl.render.canvas import Canvas, Stroke, fitted, text_width
from carrl.render.colours import BLUE, FAINT, GREEN, INK, LIGHT, PAPER, VERMILLION
from carrl.render.encoding import RULE
from carrl.render.episode import EpisodeScene

WIDTH, HEIGHT = 1280, 720
"""Of a frame, units."""
EDGE, LEFT, RIGHT = 900.0, 926.0, 1254.0
"""The panel's left edge, and where its text begins and ends."""
BARS, BARS_WIDTH = 1020.0, 150.0
"""Where the bars of the actions' values stand, between the actions' names and the figures."""
ROW, GAP = 29.0, 46.0
"""Height of a row, and distance between two parts."""
SCALE_WIDTH = 150.0
"""Of the colours of the speeds."""
MOST_VALUES = 7
"""Of actions, each with a bar."""
LEAST_DOWN = -1.0
"""A throttle or brake of its own that is released."""
CONTROL_COLOURS = {
    **{("pedal", True): GREEN, ("pedal", False): VERMILLION, ("throttle", True): GREEN, ("throttle", False): GREEN},
    **{("brake", True): VERMILLION, ("brake", False): VERMILLION},
}
"""By the name of the control, and whether it is above 0; of all others blue."""
LONGEST = 100_000
"""Values from here on are written with an exponent."""
MOST_POINTS = 330
"""Of the curve of the return, whose panel is so many units wide."""
NAME_WIDTH, SMALLEST_NAME = BARS - LEFT - 6, 11.0
"""Room for an action's name before the bars, and how small its letters may become to fit in."""


@dataclass(frozen=True, eq=False)
class Panel:
    """Draws an episode's figures at any step.

    Attributes:
        trace: the episode.
        colours: of its actions, [A].
    """

    trace: EpisodeTrace
    colours: tuple[str, ...]

    def draw(self, canvas: Canvas, step: int, share: float) -> None:
        """Draws the figures of a step, of which a share is done, over whatever reaches into the panel."""
        canvas.box(EDGE, 0, WIDTH - EDGE, HEIGHT, PAPER)
        canvas.line([(EDGE, 0), (EDGE, HEIGHT)], Stroke(RULE, 2))
        y = self._draw_counters(canvas, step, share, 34)
        y = self._draw_action(canvas, step, y)
        y = self._draw_speed(canvas, step, share, y)
        y = self._draw_action_values(canvas, step, y)
        y = self._draw_reward(canvas, step, y)
        self._draw_return(canvas, step + share, y)

    @cached_property
    def _returns(self) -> Floats:
        """Sum of the rewards before each step and after the last, [T + 1]."""
        return np.append(0.0, self.trace.rewards.cumsum())

    @cached_property
    def _scene(self) -> EpisodeScene:
        return EpisodeScene(self.trace)

    def _draw_counters(self, canvas: Canvas, step: int, share: float, y: float) -> float:
        number = int(self.trace.columns["step"][step])
        counters = (
            ("step", f"{number:,}"),
            ("time", f"{(number + share) * self.trace.scene.time_step:,.1f} s"),
            ("gates passed", f"{self.trace.gates_passed[int(step + share)]}"),
        )
        for x, (name, value) in zip((LEFT, LEFT + 102, LEFT + 220), counters, strict=True):
            canvas.text((x, y), name, 16, FAINT)
            canvas.text((x, y + 30), value, 25, INK, bold=True)
        return y + 30 + GAP

    def _draw_action(self, canvas: Canvas, step: int, y: float) -> float:
        if self.trace.controls is not None:
            return self._draw_controls(canvas, self.trace.controls, step, y)
        action = int(self.trace.actions[step])
        how, colour = ("at random", VERMILLION) if self.trace.exploratory[step] else ("greedy", FAINT)
        numbers = [
            f"{name} {series.values[step, index]:.2f}"
            for series in self._scene.told
            for index, name in enumerate(series.entries)
        ]
        y = _draw_heading(canvas, y, "action", fitted("  ".join(numbers), 18, RIGHT - LEFT - 70))
        canvas.disc((LEFT + 9, y + 23), 9, self.colours[action])
        canvas.text((LEFT + 28, y + 31), self.trace.scene.action_names[action], 23, INK, bold=True)
        canvas.text((RIGHT, y + 31), how, 18, colour, anchor="rs")
        return y + 31 + GAP

    def _draw_controls(self, canvas: Canvas, controls: Floats, step: int, y: float) -> float:
        """A bar for each control, from its middle, or for a throttle or brake of its own from where it is released."""
        trace = self.trace
        how = "" if "exploratory" not in trace.columns else "at random" if trace.exploratory[step] else "greedy"
        y = _draw_heading(canvas, y, "action", how)
        for name, value in zip(trace.scene.control_names, controls[step], strict=True):
            y += ROW
            rest = LEAST_DOWN if name in ("throttle", "brake") else 0.0
            end = -value if name == "steer" else value  # left is left
            left, right = (BARS + (each + 1) / 2 * BARS_WIDTH for each in sorted((rest, float(end))))
            colour = CONTROL_COLOURS.get((name, value > 0), BLUE)
            canvas.box(BARS, y - 15, BARS_WIDTH, 18, RULE)
            canvas.box(left, y - 15, right - left, 18, colour)
            zero = BARS + (rest + 1) / 2 * BARS_WIDTH
            canvas.line([(zero, y - 18), (zero, y + 6)], Stroke(FAINT, 1))
            _draw_name(canvas, y, name)
            canvas.text((RIGHT, y), f"{value:+.2f}", 18, INK, anchor="rs")
        return y + GAP

    def _draw_speed(self, canvas: Canvas, step: int, share: float, y: float) -> float:
        """The speed of a car that has one of its own."""
        speeds = self.trace.state("speed")
        if speeds is None:
            return y
        speed = speeds[step] + share * (speeds[step + 1] - speeds[step])
        y = _draw_heading(canvas, y, "speed", f"{speed:.1f} m/s")
        canvas.text((LEFT, y + 31), f"{3.6 * speed:.0f} km/h", 23, INK, bold=True)
        if self.trace.speeds is not None:
            _draw_scale(canvas, y + 18, (speed - speeds.min()) / np.ptp(speeds))
        return y + 31 + GAP

    def _draw_action_values(self, canvas: Canvas, step: int, y: float) -> float:
        """A bar from 0 to the number of each action, if the log has such; the one chosen is bold."""
        series = self._scene.per_action
        if series is None:
            return y
        finite = np.append(0.0, series.values[np.isfinite(series.values)])  # 0 is on the scale, infinity is not
        low, high = float(finite.min()), max(1e-9, float(finite.max()))
        scale = BARS_WIDTH / (high - low)
        zero = BARS - low * scale
        y = top = _draw_heading(canvas, y, series.title)
        actions = list(range(len(series.entries)))
        if len(actions) > MOST_VALUES:  # the greatest, the greatest first
            actions = np.argsort(-series.values[step], kind="stable")[:MOST_VALUES].tolist()
        for action in actions:
            name, value = series.entries[action], series.values[step, action]
            y, chosen = y + ROW, action == self.trace.actions[step]
            _draw_name(canvas, y, name, chosen)
            bar = float(np.nan_to_num(value, posinf=high, neginf=low)) * scale
            canvas.box(min(zero, zero + bar), y - 15, abs(bar), 18, self.colours[action])
            shown = f"{value:,.1f}" if abs(value) < LONGEST else f"{value:.1e}"
            canvas.text((RIGHT, y), shown, 18, INK, bold=chosen, anchor="rs")
        canvas.line([(zero, top + 8), (zero, y + 8)], Stroke(FAINT, 1))
        return y + GAP

    def _draw_reward(self, canvas: Canvas, step: int, y: float) -> float:
        """The reward of the step and its terms, those that are not zero in colour."""
        y = _draw_heading(canvas, y, "reward", _signed(self.trace.rewards[step]), bold=True)
        for name, value in zip(self.trace.scene.reward_terms, self.trace.reward_terms[step], strict=True):
            y += ROW - 3
            colour = GREEN if value > 0 else VERMILLION if value < 0 else FAINT
            canvas.text((LEFT, y), name, 18, colour, bold=value != 0)
            canvas.text((RIGHT, y), _signed(value), 18, colour, bold=value != 0, anchor="rs")
        return y + GAP

    def _draw_return(self, canvas: Canvas, progress: float, y: float) -> None:
        """The return over the whole episode, and in colour up to now, [0, T]."""
        now = np.interp(progress, np.arange(len(self._returns)), self._returns)
        y = _draw_heading(canvas, y, "return", f"{self._returns[int(progress)]:,.4g}", bold=True)
        finite = self._returns[np.isfinite(self._returns)]
        low, extent = finite.min(), max(finite.max() - finite.min(), 1e-9)
        height, width = HEIGHT - 24 - y - 16, RIGHT - LEFT

        def places(steps: Floats, returns: Floats) -> Floats:
            heights = np.nan_to_num((returns - low) / extent).clip(0, 1) * height
            return np.column_stack([LEFT + steps / len(self.trace) * width, HEIGHT - 24 - heights])

        last = len(self._returns) - 1
        steps = np.unique(np.linspace(0, last, min(last + 1, MOST_POINTS)).round())  # more than that nobody can see
        returns = self._returns[steps.astype(np.int64)]
        done = steps <= progress
        canvas.line(places(steps[[0, -1]], np.zeros(2)), Stroke(RULE, 1))
        canvas.line(places(steps, returns), Stroke(LIGHT.centreline, 2))
        driven = np.append(steps[done], progress), np.append(returns[done], now)
        canvas.line(places(*driven), Stroke(BLUE, 3))
        canvas.disc(places(*driven)[-1], 5, BLUE)


def _draw_heading(canvas: Canvas, y: float, name: str, value: str = "", bold: bool = False) -> float:
    """A part's name at the left and a figure at the right, below a thin line."""
    canvas.line([(LEFT, y - 26), (RIGHT, y - 26)], Stroke(RULE, 1))
    canvas.text((LEFT, y + 4), name, 18, FAINT)
    canvas.text((RIGHT, y + 4), value, 20 if bold else 18, INK if bold else FAINT, bold=bold, anchor="rs")
    return y + 4


def _draw_name(canvas: Canvas, y: float, name: str, bold: bool = False) -> None:
    """At the left, as small as it has to be."""
    size = max(SMALLEST_NAME, min(18.0, 18 * NAME_WIDTH / text_width(name, 18, bold=True)))
    canvas.text((LEFT, y), fitted(name, size, NAME_WIDTH), size, INK, bold=bold)


def _draw_scale(canvas: Canvas, y: float, share: float) -> None:
    """The colours of the speeds from the least to the greatest, and a mark at the share of the way between them."""
    shades, left = LIGHT.speed_shades, RIGHT - SCALE_WIDTH
    each = SCALE_WIDTH / len(shades)
    for index, shade in enumerate(shades):  # each to the end, so that no background shines through between two
        canvas.box(left + index * each, y, SCALE_WIDTH - index * each, 10, shade)
    at = left + share * SCALE_WIDTH
    canvas.area([[(at, y - 2), (at - 5, y - 10), (at + 5, y - 10)]], INK)


def _signed(value: float) -> str:
    return f"{value:+,.4g}" if value else "0"
