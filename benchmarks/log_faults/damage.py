"""Damaged logs, made by a seeded generator out of a log and another run's.

A place in a file is any byte, or the begin or end of a record, so that whole records get lost, doubled and displaced,
too.
"""

import math
from collections.abc import Callable
from random import Random

from benchmarks.log_faults.sample import Sample

SEVERAL = "several at once"
_MOST_FLIPS = 8
_MOST_NOISE_BYTES = 2**14
_AT_ONCE = (1, 1, 1, 2, 3, 4)
_AT_A_BOUNDARY = 0.4

Damage = Callable[[Random, bytes, Sample, Sample], bytes]
"""Makes damaged bytes out of a file's bytes, the log that it was made of, and another run's log."""


def damage(draw: Random, own: Sample, other: Sample) -> tuple[str, bytes]:
    """What was done to the log, and the bytes of the damaged file."""
    names = draw.choices(list(DAMAGES), k=draw.choice(_AT_ONCE))
    content = own.content
    for name in names:
        content = DAMAGES[name](draw, content, own, other)
    return names[0] if len(names) == 1 else SEVERAL, content


def _cut_off(draw: Random, content: bytes, own: Sample, _other: Sample) -> bytes:
    return content[: _place(draw, content, own)]


def _flip_bytes(draw: Random, content: bytes, _own: Sample, _other: Sample) -> bytes:
    return _flip(draw, content, lambda: draw.randrange(1, 256))


def _flip_bits(draw: Random, content: bytes, _own: Sample, _other: Sample) -> bytes:
    return _flip(draw, content, lambda: 1 << draw.randrange(8))


def _flip(draw: Random, content: bytes, draw_mask: Callable[[], int]) -> bytes:
    flipped = bytearray(content)
    for _ in range(draw.randint(1, _MOST_FLIPS) if content else 0):
        flipped[draw.randrange(len(content))] ^= draw_mask()
    return bytes(flipped)


def _zero(draw: Random, content: bytes, own: Sample, _other: Sample) -> bytes:
    begin, end = _slice(draw, content, own)
    return content[:begin] + bytes(end - begin) + content[end:]


def _overwrite_with_noise(draw: Random, content: bytes, own: Sample, _other: Sample) -> bytes:
    begin, end = _slice(draw, content, own)
    return content[:begin] + draw.randbytes(end - begin) + content[end:]


def _insert_noise(draw: Random, content: bytes, own: Sample, _other: Sample) -> bytes:
    place = _place(draw, content, own)
    return content[:place] + _noise(draw) + content[place:]


def _append_noise(draw: Random, content: bytes, _own: Sample, _other: Sample) -> bytes:
    return content + draw.choice([_noise(draw), bytes(len(_noise(draw)))])


def _delete(draw: Random, content: bytes, own: Sample, _other: Sample) -> bytes:
    begin, end = _slice(draw, content, own)
    return content[:begin] + content[end:]


def _double(draw: Random, content: bytes, own: Sample, _other: Sample) -> bytes:
    begin, end = _slice(draw, content, own)
    place = _place(draw, content, own)
    return content[:place] + content[begin:end] + content[place:]


def _displace(draw: Random, content: bytes, own: Sample, _other: Sample) -> bytes:
    begin, end = _slice(draw, content, own)
    rest = content[:begin] + content[end:]
    place = _place(draw, rest, own)
    return rest[:place] + content[begin:end] + rest[place:]


def _insert_other(draw: Random, content: bytes, own: Sample, other: Sample) -> bytes:
    begin, end = _slice(draw, other.content, other)
    place = _place(draw, content, own)
    return content[:place] + other.content[begin:end] + content[place:]


def _overwrite_with_other(draw: Random, content: bytes, _own: Sample, other: Sample) -> bytes:
    """As where two files' blocks got mixed up: the same place of the other log."""
    begin, end = _slice(draw, other.content, other)
    return content[:begin] + other.content[begin:end] + content[end:]


def _begin_with_other(draw: Random, content: bytes, _own: Sample, other: Sample) -> bytes:
    place = _place(draw, other.content, other)
    return other.content[:place] + content[place:]


def _end_with_other(draw: Random, content: bytes, own: Sample, other: Sample) -> bytes:
    return content[: _place(draw, content, own)] + other.content[_place(draw, other.content, other) :]


DAMAGES: dict[str, Damage] = {
    "cut off": _cut_off,
    "1 to 8 bytes flipped": _flip_bytes,
    "1 to 8 bits flipped": _flip_bits,
    "a slice zeroed": _zero,
    "a slice overwritten with noise": _overwrite_with_noise,
    "noise inserted": _insert_noise,
    "noise or zeros appended": _append_noise,
    "a slice deleted": _delete,
    "a slice doubled": _double,
    "a slice displaced": _displace,
    "a slice of another run's log inserted": _insert_other,
    "overwritten with a slice of another run's log": _overwrite_with_other,
    "begins as another run's log": _begin_with_other,
    "ends as another run's log": _end_with_other,
}
"""What is done to logs, by name."""


def _place(draw: Random, content: bytes, sample: Sample) -> int:
    if draw.random() < _AT_A_BOUNDARY:
        return min(draw.choice(sample.boundaries), len(content))
    return draw.randint(0, len(content))


def _slice(draw: Random, content: bytes, sample: Sample) -> tuple[int, int]:
    """Begin and end; as likely to be of one byte as of thousands."""
    begin = _place(draw, content, sample)
    if draw.random() < _AT_A_BOUNDARY:
        return min(begin, end := _place(draw, content, sample)), max(begin, end)
    length = round(math.exp(draw.uniform(0.0, math.log(max(2, len(content))))))
    return begin, min(begin + length, len(content))


def _noise(draw: Random) -> bytes:
    return draw.randbytes(draw.randint(1, _MOST_NOISE_BYTES))
