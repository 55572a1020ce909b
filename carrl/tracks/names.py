"""Which tracks go by a name; nothing here waits for torch, so that a misspelt one is answered at once."""

import os
from pathlib import Path

from carrl.errors import TrackError, did_you_mean

VARIABLE = "CARRL_TRACKS"
"""The environment variable with the folders whose tracks go by their names."""
BUILT_IN = ("oval", "paper", "serpentine", "grand_prix")
"""Names of the tracks that come with CarRL."""


def check_may_exist(name_or_path: str | Path) -> None:
    """Refuses a track that is neither built in nor a file, unless the library of `CARRL_TRACKS` may have it.

    Raises:
        TrackError: it cannot be any track.
    """
    if str(name_or_path) in BUILT_IN or os.environ.get(VARIABLE) or os.path.exists(name_or_path):
        return
    raise unknown_track(name_or_path)


def unknown_track(name_or_path: str | Path) -> TrackError:
    """The error that says which tracks there are instead."""
    others = f"{VARIABLE} may list folders of others"
    if os.environ.get(VARIABLE):
        others = f"none in the folders of {VARIABLE} has this name; see carrl track list"
    close = did_you_mean(str(name_or_path), BUILT_IN)
    return TrackError(
        f"track '{name_or_path}': no file of this path and no built-in track of this name{close or ';'} the built-in "
        f"ones are {', '.join(BUILT_IN)}, and {others}"
    )
