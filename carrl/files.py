"""A way onto the disk that never leaves half a file, and a way from it that never takes in more than it should."""

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO
from uuid import uuid4

import yaml

from carrl.errors import CarrlError

_LONGEST_NUMBER = 64
"""Characters; what is longer is read as text, since Python takes minutes to read a number of a million digits."""
MOST_EXPANDED = 2**20
"""Characters and values that a text may stand for, every alias written out."""
MOST_DEPTH = 64
"""Lists and mappings within each other."""
_MERGE = "tag:yaml.org,2002:merge"
_SafeLoader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # ten times faster where PyYAML has it


class _Loader(_SafeLoader):
    """PyYAML's safe loader without what makes a small file large or slow."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """A mapping in which every key stands once."""
        seen = set()
        for key, _ in node.value if isinstance(node, yaml.MappingNode) else ():
            if key.tag == _MERGE:
                raise yaml.constructor.ConstructorError(problem="mappings are not merged", problem_mark=key.start_mark)
            if isinstance(key, yaml.ScalarNode) and key.value in seen:
                problem = f"the key {key.value[:40]} stands in it twice; keep one of the two"
                raise yaml.constructor.ConstructorError(problem=problem, problem_mark=key.start_mark)
            seen.add(key.value if isinstance(key, yaml.ScalarNode) else None)
        values: dict[Any, Any] = super().construct_mapping(node, deep)
        return values

    def construct_short_number(self, node: yaml.ScalarNode) -> Any:
        """A whole number or another, or the text where that is too long for one."""
        if isinstance(node.value, str) and len(node.value) > _LONGEST_NUMBER:
            return node.value
        return self.construct_yaml_int(node) if node.tag.endswith(":int") else self.construct_yaml_float(node)


for _kind in ("int", "float"):
    _Loader.add_constructor(f"tag:yaml.org,2002:{_kind}", _Loader.construct_short_number)


def parse_yaml(content: bytes) -> Any:
    """The values of the one document in a YAML text; None where it is empty.

    Aliases share a value; written out they are at most `MOST_EXPANDED`, and none leads back to itself.

    Raises:
        ValueError: it is no such text; the message can stand behind the file's name and a colon.
    """
    try:
        loader = _Loader(content.decode("utf-8-sig"))
        try:
            node = loader.get_single_node()
            if node is None:
                return None
            _Expansion().of(node)
            return loader.construct_document(node)
        finally:
            loader.dispose()
    except yaml.MarkedYAMLError as error:
        line = f"line {error.problem_mark.line + 1}: " if error.problem_mark else ""
        raise ValueError(f"{line}this is not YAML: {' '.join(str(error.problem).split())[:80]}") from None
    except _TooLargeError as error:
        raise ValueError(str(error)) from None
    except Exception:  # PyYAML's constructors raise whatever a text such as `!!bool maybe` leads them to
        raise ValueError("this is not a YAML text file") from None


class _TooLargeError(Exception):
    """A text that stands for too much; the message says why."""

    def __init__(self, node: yaml.Node, reason: str) -> None:
        super().__init__(f"line {node.start_mark.line + 1}: {reason}")


class _Expansion:
    """How much the nodes of a text stand for, each counted once and used as often as aliases use it."""

    def __init__(self) -> None:
        self._sizes: dict[yaml.Node, int | None] = {}  # None while a node's own parts are counted

    def of(self, node: yaml.Node, depth: int = 0) -> int:
        """Characters and values of a node, every alias in it written out."""
        size = self._sizes.get(node, 0)
        if size is None:
            raise _TooLargeError(node, "an alias in this leads back to it; write a value instead")
        if size:
            return size
        if depth >= MOST_DEPTH and isinstance(node, yaml.CollectionNode):
            raise _TooLargeError(node, f"more than {MOST_DEPTH} lists or mappings stand within each other")
        self._sizes[node] = None
        size = 1 + (len(node.value) if isinstance(node, yaml.ScalarNode) else 0)
        for part in _parts(node):
            size += self.of(part, depth + 1)
            if size > MOST_EXPANDED:
                raise _TooLargeError(node, f"its aliases stand for more than {MOST_EXPANDED} characters; shorten it")
        self._sizes[node] = size
        return size


def _parts(node: yaml.Node) -> Iterator[yaml.Node]:
    """A list's values, or a mapping's keys and values."""
    for part in node.value if isinstance(node, yaml.CollectionNode) else ():
        yield from part if isinstance(node, yaml.MappingNode) else (part,)


PARTIAL = ".*.partial"
"""Matches the files that a killed process may leave behind."""
_CHUNK_BYTES = 2**24


@contextmanager
def appearing_whole(path: str | Path, error: type[CarrlError] = CarrlError) -> Iterator[Path]:
    """Yields a place to write to, and moves what is there to `path` unless something fails.

    A reader sees the old file or the new one and never a part.

    Raises:
        CarrlError: or the kind of it that `error` is: the file cannot be written there.
    """
    path = Path(path)
    partial = path.parent / f".{uuid4().hex}.partial"  # no part of the name, which may be as long as names may be
    try:
        yield partial
        os.replace(partial, path)
    except (OSError, ValueError) as failure:  # ValueError: a NUL in the path
        reason = getattr(failure, "strerror", None) or failure
        raise error(f"'{path}' cannot be written: {reason}; choose another place") from failure
    finally:
        with suppress(OSError, ValueError):
            partial.unlink()


def remove_left_overs(*folders: Path) -> None:
    """Removes what killed processes left of files that they were writing in these folders, which may be missing."""
    for folder in folders:
        for partial in folder.glob(PARTIAL):
            if partial.is_symlink() or not partial.is_dir():  # a folder is not what they left
                partial.unlink()


def write_whole(path: str | Path, content: bytes, error: type[CarrlError] = CarrlError, durably: bool = False) -> None:
    """Writes a file as `appearing_whole` lets it appear; `durably` waits until the disk has it."""
    with appearing_whole(path, error) as partial, partial.open("wb") as file:
        file.write(content)
        if durably:
            file.flush()
            os.fsync(file.fileno())


def read_whole(
    path: Path, most: int, name: str, error: type[CarrlError] = CarrlError, *, follow_links: bool = True
) -> bytes:
    """All bytes of a regular file of at most `most`.

    Args:
        path: of the file.
        most: how many bytes it may have.
        name: what the file is called in messages, such as "track 'oval.csv'".
        error: the kind of error to raise.
        follow_links: whether a link to a file will do.

    Raises:
        CarrlError: it is missing, larger, a folder, a pipe or a device, or cannot be read.
    """
    try:
        with open(path, "rb", opener=_open_without_waiting if follow_links else open_itself) as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):  # a pipe would block, a device might never end
                raise error(f"{name}: this is not a regular file; name one")
            content = _read_at_most(file, most + 1)
    except IsADirectoryError:
        raise error(f"{name}: this is a folder; name a file in it") from None
    except (OSError, ValueError) as failure:  # ValueError: a NUL in the path
        raise error(f"{name}: cannot be read: {getattr(failure, 'strerror', None) or failure}") from failure
    if len(content) > most:
        raise error(f"{name}: the file is too large; it may have at most {most} bytes")
    return content


def _read_at_most(file: BinaryIO, most: int) -> bytes:
    """Reads bit by bit, since one `read` sets aside as much memory as it may return, however small the file is."""
    chunks: list[bytes] = []
    while most > 0 and (chunk := file.read(min(most, _CHUNK_BYTES))):
        chunks.append(chunk)
        most -= len(chunk)
    return b"".join(chunks)


def _open_without_waiting(path: str, flags: int) -> int:
    """Opens a pipe, too, without waiting for someone to write to it."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def open_itself(path: str, flags: int) -> int:
    """An opener for `open` that follows no link in the file's place, nor waits for the other end of a pipe.

    Raises:
        OSError: there is a link, or the file cannot be opened.
    """
    try:
        return os.open(path, flags | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOFOLLOW", 0), 0o666)
    except OSError as failure:
        if failure.errno == errno.ELOOP and os.path.islink(path):
            raise OSError(errno.ELOOP, "it is a symbolic link", str(path)) from None
        raise
