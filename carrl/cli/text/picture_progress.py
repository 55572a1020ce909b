"""How many pictures of a video are drawn, which takes its time."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def pictures_drawn() -> Iterator[Callable[[int, int], None]]:
    """Shows a bar on a terminal; what it yields is to be called with the pictures drawn and those to draw."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("pictures", total=None)
        yield lambda done, of: progress.update(task, completed=done, total=of)
