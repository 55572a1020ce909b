"""Where new runs may begin: in folders that no other run has; nothing here waits for torch."""

import itertools
import os
from collections.abc import Iterator
from pathlib import Path

from carrl.errors import CarrlError, CheckpointError, ConfigError
from carrl.train.files import CONFIG, EVALUATIONS, LAP, LEARNING_CURVE, LOG, METRICS, SUMMARY, load_config

_NAMES = (SUMMARY, LOG, "checkpoints/state.pt", METRICS, EVALUATIONS, str(CONFIG), LEARNING_CURVE, LAP)
_PATTERNS = ("checkpoints/*.pt", f"{Path(LOG).stem}-*{Path(LOG).suffix}")


def make_new(folder: Path) -> Path:
    """Makes a folder that was not there: NAME or, where that is taken, the first of NAME-2, NAME-3, ... that is not.

    Raises:
        CarrlError: it cannot be made.
    """
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CarrlError(f"the folder '{folder.parent}' cannot be made: {error.strerror}") from error
    for number in itertools.count(1):
        candidate = folder if number == 1 else folder.with_name(f"{folder.name}-{number}")
        try:
            candidate.mkdir()
        except FileExistsError:
            continue
        except OSError as error:
            raise CarrlError(f"the folder '{candidate}' cannot be made: {error.strerror}") from error
        break
    return candidate


def check_holds_no_run(folder: Path) -> None:
    """Lets no run begin where another one has left anything, or one of its seeds has, nor anywhere below a run.

    Raises:
        ConfigError: something is there, were it a dangling link by the name of a run's file, or a run is above.
    """
    check_is_in_no_run(folder)
    found = next((left for place in (folder, *sorted(folder.glob("seed=*"))) for left in _left_in(place)), None)
    if found is None:
        return
    go_on = f"go on with it: carrl train resume={folder}, or " if os.path.lexists(folder / CONFIG) else ""
    name = found.relative_to(folder)
    raise ConfigError(f"'{folder}' has a run already, whose {name} would be overwritten; {go_on}choose another folder")


def check_is_in_no_run(folder: Path) -> None:
    """Lets nothing begin in the folder of a run, whose report would show what is below alone.

    Raises:
        ConfigError: a folder above is a run's.
    """
    for above in Path(os.path.realpath(folder)).parents:
        if os.path.lexists(above / CONFIG) and _is_run(above):
            raise ConfigError(f"'{folder}' lies in the folder of the run '{above}'; choose a folder outside of it")


def _is_run(folder: Path) -> bool:
    """Whether what Hydra left here is a run's configuration, and not another program's."""
    try:
        load_config(folder)
    except CheckpointError:
        return False
    return True


def _left_in(folder: Path) -> Iterator[Path]:
    """What runs have left here."""
    yield from (folder / name for name in _NAMES if os.path.lexists(folder / name))
    for pattern in _PATTERNS:
        yield from sorted(folder.glob(pattern))
    checkpoints = folder / "checkpoints"
    if os.path.lexists(checkpoints) and not checkpoints.is_dir():
        yield checkpoints
