"""Changes files at random: bytes, numbers, lines, and pieces of one file in another."""

import re
from collections.abc import Sequence
from random import Random

NUMBERS = (
    *("0", "-0.0", "1", "-1", "2", "3", "0.01", "0.5", "7", "10", "30", "1000", "65536", "100000", "99999.99"),
    *("1e-9", "1e-300", "5e-324", "1e9", "-1e5", "1e15", "1e308", "1e999", "-1e999", "9007199254740993", "2147483648"),
    *("18446744073709551616", "9" * 400, "0x7fffffffffffffff", "1_000", "1:30:00", "nan", ".nan", "NaN", "inf"),
    *("-.inf", "Infinity", "", "null", "~", "true", "ten", "1,5", "\uff11\uff12"),
)
"""What may stand in the place of a number."""
PIECES = (
    *(b"\x00", b"\xff\xfe", b"\xef\xbb\xbf", b"\r", b"\n\n", b",", b",,,,", b'"', b"'", b"#", b": ", b"- ", b"[", b"]"),
    *(b"{", b"}", b"&a ", b"*a", b"<<: *a\n", b"!!python/object/apply:os.system ['true']", b"!!binary x", b"!!int ''"),
    *(
        b"!!bool x",
        b"!!timestamp x",
        b"!!set {a}",
        b"? ",
        b"|\n",
        b"---\n",
        b"%YAML 9.9\n",
        b"[" * 2000,
        b'{"a":' * 2000,
    ),
    *(b"\x1b[2J\x1b]0;x\x07", "\u202e\u2028\ud7ff".encode(), b"9" * 5000, b"a" * 140_000),
)
"""What may be inserted anywhere."""
_NUMBER = re.compile(rb"-?\d+\.?\d*(?:e[+-]?\d+)?")


def mutate(draw: Random, content: bytes, corpus: Sequence[bytes]) -> bytes:
    """The content with one to four changes.

    Args:
        draw: of the changes.
        content: of a file.
        corpus: files to take pieces from.
    """
    for _ in range(draw.choice((1, 1, 1, 2, 3, 4))):
        content = draw.choice((_flip, _cut, _delete, _double, _insert, _splice, _renumber, _renumber, _move_line))(
            draw, content, corpus
        )
    return content


def _slice(draw: Random, content: bytes) -> tuple[int, int]:
    begin = draw.randint(0, len(content))
    return begin, min(len(content), begin + draw.choice((1, 2, 4, 8, 20, 100, 1000)))


def _flip(draw: Random, content: bytes, _: Sequence[bytes]) -> bytes:
    changed = bytearray(content)
    for _ in range(draw.randint(1, 8) if content else 0):
        changed[draw.randrange(len(content))] = draw.choice((0, 1, 255, 128, draw.randrange(256)))
    return bytes(changed)


def _cut(draw: Random, content: bytes, _: Sequence[bytes]) -> bytes:
    return content[: draw.randint(0, len(content))]


def _delete(draw: Random, content: bytes, _: Sequence[bytes]) -> bytes:
    begin, end = _slice(draw, content)
    return content[:begin] + content[end:]


def _double(draw: Random, content: bytes, _: Sequence[bytes]) -> bytes:
    begin, end = _slice(draw, content)
    return content[:begin] + content[begin:end] * draw.choice((2, 2, 2, 50)) + content[end:]


def _insert(draw: Random, content: bytes, _: Sequence[bytes]) -> bytes:
    place = draw.randint(0, len(content))
    return content[:place] + draw.choice(PIECES) + content[place:]


def _splice(draw: Random, content: bytes, corpus: Sequence[bytes]) -> bytes:
    other = draw.choice(corpus)
    begin, end = _slice(draw, other)
    place, rest = _slice(draw, content)
    return content[:place] + other[begin:end] + content[rest:]


def _renumber(draw: Random, content: bytes, _: Sequence[bytes]) -> bytes:
    numbers = list(_NUMBER.finditer(content))
    if not numbers:
        return content
    found = draw.choice(numbers)
    return content[: found.start()] + draw.choice(NUMBERS).encode() + content[found.end() :]


def _move_line(draw: Random, content: bytes, _: Sequence[bytes]) -> bytes:
    lines = content.splitlines(keepends=True)
    if lines:
        lines.insert(draw.randint(0, len(lines) - 1), lines.pop(draw.randrange(len(lines))))
    return b"".join(lines)
