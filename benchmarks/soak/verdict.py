"""A long run in ten parts, and whether its memory and handles are flat."""

from collections.abc import Iterator, Sequence
from statistics import median

from benchmarks.soak.process import Sample

PARTS = 10
SETTLED = 2
"""Parts after which the replay buffer is full and nothing may grow any more."""
MOST_GROWTH = 0.05
"""Of the memory, from the first part after that to any later one."""
HEADER = ("frames", "s", "frames/s", "RSS MiB: median", "max", "handles: median", "max", "threads", "folder MiB")


def parts(samples: Sequence[Sample], frames: int) -> list[list[Sample]]:
    """The samples in ten parts of equally many frames.

    A single look may fall on the making of a checkpoint, which takes memory and a handle for a moment; many do not.
    """
    found: list[list[Sample]] = [[] for _ in range(PARTS)]
    for sample in samples:
        if sample.frames > 0:
            found[min(sample.frames * PARTS // frames, PARTS - 1)].append(sample)
    return found


def row(number: int, part: Sequence[Sample], frames: int, before_s: float) -> list[str]:
    """A part's figures under `HEADER`; `before_s` is when the last part ended."""
    up_to = f"{frames * (number + 1) // PARTS:,}"
    if not part:
        return [up_to, *["-"] * (len(HEADER) - 1)]
    memory, handles = [sample.memory_mib for sample in part], [sample.handles for sample in part]
    end_s = part[-1].seconds
    return [
        up_to,
        f"{end_s:,.0f}",
        f"{frames / PARTS / (end_s - before_s):,.0f}" if end_s > before_s else "-",
        f"{median(memory):.1f}",
        f"{max(memory):.1f}",
        f"{median(handles):g}",
        str(max(handles)),
        f"{median(sample.threads for sample in part):g}",
        f"{part[-1].folder_mib:.1f}",
    ]


def growth(in_parts: Sequence[Sequence[Sample]]) -> Iterator[str]:
    """Sentences on what grows though it should not."""
    settled = [(number, part) for number, part in enumerate(in_parts, start=1) if part and number > SETTLED]
    if len(settled) < 2:
        yield "the run was too short to tell: fewer than two of its later parts were looked at"
        return
    (_, first), *later = settled
    memory = median(sample.memory_mib for sample in first)
    handles = median(sample.handles for sample in first)
    for number, part in later:
        own = median(sample.memory_mib for sample in part)
        if own > (1 + MOST_GROWTH) * memory:
            yield f"memory grew from {memory:.1f} MiB to {own:.1f} MiB in part {number} of {PARTS}"
        if median(sample.handles for sample in part) > handles:
            yield f"handles grew from {handles:g} in part {number} of {PARTS}"
