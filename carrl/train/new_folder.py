"""Folders for new runs, which no other run has, and one process at a time in each; nothing here waits for torch.

.lock    names the process that is at work in the folder. What counts is the operating system's lock on the file, which
         ends with its holder however that ends: a file left by a killed process keeps nobody out.
"""

import fcntl
import itertools
import logging
import os
import platform
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from carrl.errors import CarrlError, CheckpointError, ConfigError, printable
from carrl.train.files import CONFIG, EVALUATIONS, LAP, LEARNING_CURVE, LOG, METRICS, SUMMARY, read_config

LOCK = ".lock"
_LONGEST_HOLDER_BYTES = 100
_logger = logging.getLogger(__name__)
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
        read_config(folder)
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


@contextmanager
def locked(folder: Path, waiting: bool = False) -> Iterator[None]:
    """Keeps other processes out of a folder, which is made if there is none.

    Args:
        folder: a run's, a sweep's or a study's.
        waiting: until another process that is at work there has ended its work, instead of raising an error.

    Raises:
        CarrlError: another process is at work there, or the folder cannot be written.
    """
    descriptor = _locked_file(folder, fcntl.LOCK_EX | (0 if waiting else fcntl.LOCK_NB))
    try:
        yield
    finally:
        with suppress(OSError):
            if _is_at(folder / LOCK, descriptor):  # not where the folder was moved and another one is in its place
                (folder / LOCK).unlink()
        os.close(descriptor)


def _locked_file(folder: Path, operation: int) -> int:
    """The descriptor of the folder's lock file, with the lock on it."""
    path = folder / LOCK
    while True:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, 0o666)
        except FileNotFoundError:  # the folder was removed between the two
            continue
        except FileExistsError:
            raise CarrlError(f"'{folder}' is not a folder; name one, or a place for a new one") from None
        except OSError as error:
            raise CarrlError(f"the folder '{folder}' cannot be written: {LOCK}: {error.strerror}") from error
        try:
            _lock(folder, descriptor, operation)
            if _is_at(path, descriptor):  # else its holder has removed it meanwhile
                return descriptor
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)


def _lock(folder: Path, descriptor: int, operation: int) -> None:
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        raise CarrlError(f"the folder '{folder}' cannot be written: {LOCK} is not a regular file; remove it")
    try:
        fcntl.flock(descriptor, operation)
    except BlockingIOError:
        raise CarrlError(
            f"'{folder}' is in use by {_holder(descriptor)}; wait until it has ended, or choose another folder"
        ) from None
    except OSError as error:  # a file system without locks
        _logger.warning("'%s' cannot be locked (%s); let no other process use it.", folder, error.strerror)
    with suppress(OSError):  # the name is a courtesy, for which a full disk may have no room
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, f"{os.getpid()} {platform.node()}\n".encode(), 0)


def _holder(descriptor: int) -> str:
    """Who holds the lock, in words."""
    text = os.pread(descriptor, _LONGEST_HOLDER_BYTES, 0).decode(errors="replace")
    process, _, host = printable(text.strip()).partition(" ")
    if not process:  # it has the lock, but has not yet written
        return "another process"
    return f"process {process}" + (f" on {host}" if host != platform.node() else "")


def _is_at(path: Path, descriptor: int) -> bool:
    """Whether the path leads to the open file."""
    try:
        return os.path.samestat(os.fstat(descriptor), path.lstat())
    except OSError:
        return False
