"""The user's own cache folder, where what takes long is kept between processes: code, which is run, and laps."""

import os
import stat
from pathlib import Path

_WRITABLE_BY_OTHERS = stat.S_IWGRP | stat.S_IWOTH


class CacheError(Exception):
    """Nothing can be kept in a place that is the user's alone; the message says why."""


def cache_dir() -> Path:
    """Where it is kept."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache").absolute() / "carrl"


def own_cache_dir() -> Path:
    """The cache folder, made if need be.

    Raises:
        CacheError: others can write to it, or put another folder in its place.
        OSError: it cannot be made.
    """
    folder = cache_dir()
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    if not is_own(folder.stat()):
        raise CacheError(f"'{folder}' belongs to another user or can be written by others; remove it")
    for parent in (*folder.parents, *folder.resolve().parents):
        mode = parent.stat().st_mode
        if mode & stat.S_IWOTH and not mode & stat.S_ISVTX:
            raise CacheError(f"'{folder}' can be replaced by others, who can write to '{parent}'; chmod o-w '{parent}'")
    return folder


def is_own(status: os.stat_result) -> bool:
    """Whether it is the user's, and nobody else may write to it."""
    return status.st_uid == os.getuid() and not status.st_mode & _WRITABLE_BY_OTHERS


def forget_least_used(folder: Path, pattern: str, most_bytes: int, newest: Path) -> None:
    """Deletes the files of a pattern beyond so many bytes, those used longest ago first, but never the newest one."""
    sizes: dict[Path, tuple[int, int]] = {}
    for path in folder.glob(pattern):
        try:
            status = path.lstat()
        except FileNotFoundError:  # another process has forgotten it
            continue
        sizes[path] = status.st_mtime_ns, status.st_size
    total = sizes.pop(newest, (0, 0))[1]
    for path in sorted(sizes, key=lambda each: sizes[each], reverse=True):
        total += sizes[path][1]
        if total > most_bytes:
            path.unlink(missing_ok=True)
