"""Flags of the verbs that are not Hydra's, whose mistakes end in one sentence, too."""

import argparse
import math
import re
from pathlib import Path
from typing import NoReturn

from carrl.errors import ConfigError, did_you_mean


class Parser(argparse.ArgumentParser):
    """An argument parser that raises ConfigError instead of printing its usage and ending the process."""

    def error(self, message: str) -> NoReturn:
        """Raises ConfigError."""
        unknown = re.fullmatch(r"unrecognized arguments: (-[^ =]+).*", message, flags=re.DOTALL)
        close = did_you_mean(unknown[1], (*self._option_string_actions, "--version")) if unknown else ""
        raise ConfigError(f"{' '.join(message.split())}{close or ';'} {self.prog} --help tells more")


def named_folder(text: str) -> Path:
    """The folder of this name; an empty one, as of a variable that is not set, would be the current folder."""
    if not text.strip():
        raise argparse.ArgumentTypeError("it lacks its value; name a folder")
    return Path(text)


def add_trust(parser: argparse.ArgumentParser) -> None:
    """Adds the flag by which a run's folder may name parts that are not CarRL's."""
    parser.add_argument(
        "--trust",
        action="append",
        default=[],
        metavar="MODULE",
        help="build parts of this module of your own, given by its name or file, if the run has any; may be repeated",
    )


def check_fps(fps: float | None) -> None:
    """Raises ConfigError for `--fps`, time steps a second, that is given and no positive number."""
    if fps is not None and not (math.isfinite(fps) and fps > 0):
        raise ConfigError(f"--fps is {fps}; it must be a positive number of time steps a second")
