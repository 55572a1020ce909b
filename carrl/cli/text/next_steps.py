"""What to type next, at the end of a command; nothing here waits for torch."""

import shlex
import shutil
import sys
from pathlib import Path

from carrl.errors import printable


def print_next(*steps: tuple[str, str]) -> None:
    """Prints commands, given without `carrl`, each on a line of its own below what it does, ready to be copied."""
    print("next:")
    for command, what in steps:
        print(f"  # {what}")
        print(printable(f"  {carrl_command()} {command}"))


def carrl_command() -> str:
    """How `carrl` is called here: by its name if the shell finds it, else by its path, as right after scripts/train."""
    if shutil.which("carrl") is not None:
        return "carrl"
    script = Path(sys.executable).absolute().with_name("carrl")
    if not script.is_file():
        return "carrl"
    here = Path.cwd()
    return shlex.quote(str(script.relative_to(here) if script.is_relative_to(here) else script))
