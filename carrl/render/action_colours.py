"""The colour of each action, the same in every picture; without torch."""

from itertools import cycle, islice

from carrl.render.figure import BLACK, BLUE, GREEN, VERMILLION, YELLOW


def action_colours(count: int) -> tuple[str, ...]:
    """Colours of so many actions: black for forward, vermillion for left, blue for right, then others."""
    return tuple(islice(cycle((BLACK, VERMILLION, BLUE, GREEN, YELLOW)), count))
