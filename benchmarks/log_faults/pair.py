"""Two commands that begin at the same moment and want the same folder or file, and what became of their work.

Both are forked from this process, wait for each other, and are then `carrl` itself.
"""

import json
import multiprocessing
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, redirect_stderr, redirect_stdout
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from benchmarks.child import BenchError, last_line
from benchmarks.log_faults.contents import LogContents, read_contents
from benchmarks.log_faults.same_run import RunContents, differences, read_run
from carrl.errors import CarrlError
from carrl.log import verify
from carrl.train.files import LOG
from carrl.train.sweep import JOB, SweepFolder

RUN, RESUME, SWEEP, RECOVERY = "run", "resume", "sweep", "recovery"
KINDS = (RUN, RESUME, SWEEP, RECOVERY)
SEEDS = (1, 2)
"""Of the two runs that want the same folder, and of the two jobs of a sweep."""
BEGUN_FRAMES = 64
"""How far a run has come that is resumed twice at once."""
LONGEST_S = 600.0
_KEPT = 0.7
"""The share of a log's bytes that are there to be recovered."""


@dataclass(frozen=True)
class References:
    """What the commands leave when nobody else is at work, and what they begin from.

    Attributes:
        overrides: of every training run.
        runs: by seed.
        begun: the folder of a run that is to be resumed.
        resumed: what it is at its end.
        damaged: a log that was cut off.
        recovered: what is recovered of it.
    """

    overrides: Sequence[str]
    runs: dict[int, RunContents]
    begun: Path
    resumed: RunContents
    damaged: Path
    recovered: LogContents


@dataclass
class Pair:
    """What became of a pair.

    Attributes:
        kind: one of `KINDS`.
        codes: the exit codes of the two.
        sentence: what the one said that was refused.
        faults: whatever is not as it should be, each as a sentence.
    """

    kind: str
    codes: list[int]
    sentence: str = ""
    faults: list[str] = field(default_factory=list)


def make_references(folder: Path, overrides: Sequence[str], frames: int) -> References:
    """Runs every command alone.

    Args:
        folder: an empty one.
        overrides: of Hydra, but for the number of frames.
        frames: that runs have at their end.

    Raises:
        BenchError: one of them failed.
    """
    whole = [*overrides, f"trainer.frames={frames}"]
    for seed in SEEDS:
        _run_alone(folder, ["train", *whole, f"seed={seed}", f"hydra.run.dir={folder}/{seed}"])
    _run_alone(folder, ["train", *overrides, f"trainer.frames={BEGUN_FRAMES}", f"hydra.run.dir={folder}/begun"])
    shutil.copytree(folder / "begun", folder / "resumed")
    _run_alone(folder, ["train", f"resume={folder}/resumed", f"trainer.frames={frames}"])
    damaged, content = folder / "damaged.mcap", (folder / str(SEEDS[0]) / LOG).read_bytes()
    damaged.write_bytes(content[: round(_KEPT * len(content))])
    _run_alone(folder, ["log", "recover", str(damaged), f"{folder}/recovered.mcap"])
    return References(
        whole,
        {seed: read_run(folder / str(seed)) for seed in SEEDS},
        folder / "begun",
        read_run(folder / "resumed"),
        damaged,
        read_contents(folder / "recovered.mcap"),
    )


def run_pair(kind: str, references: References) -> Pair:
    """Runs two commands of a kind at once, and compares what they leave with the references."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        commands = _commands(kind, folder / "wanted", references)
        outcomes = start_together(folder, commands)
        pair = judge(kind, outcomes)
        if 0 in pair.codes:
            try:
                pair.faults += _losses(kind, folder / "wanted", pair.codes.index(0), references)
            except (CarrlError, OSError, ValueError, KeyError) as error:
                pair.faults.append(f"{type(error).__name__}: {error}")
        return pair


def judge(kind: str, outcomes: Sequence[tuple[int, str]]) -> Pair:
    """Whether one of the two succeeded and the other ended in one sentence.

    Args:
        kind: of the pair.
        outcomes: the exit code of each, and all that it printed.
    """
    pair = Pair(kind, [code for code, _ in outcomes])
    refused = [printed.strip() for code, printed in outcomes if code != 0]
    if pair.codes.count(0) != 1 or len(refused) != 1:
        pair.faults.append(
            f"not one success but {pair.codes.count(0)}: {' | '.join(last_line(t) for _, t in outcomes)}"
        )
        return pair
    pair.sentence = last_line(refused[0])
    if 2 not in pair.codes or not refused[0].startswith("carrl: ") or "\n" in refused[0]:
        pair.faults.append(f"not one sentence and exit code 2 but {pair.codes}: {refused[0]}")
    return pair


def start_together(folder: Path, commands: Sequence[Sequence[str]]) -> list[tuple[int, str]]:
    """Runs `carrl` with these arguments, all from the same moment on, and returns exit codes and what was printed.

    Raises:
        BenchError: one of them does not end.
    """
    context = multiprocessing.get_context("fork")
    barrier = context.Barrier(len(commands))
    consoles = [folder / f"console-{index}.txt" for index in range(len(commands))]
    processes = [
        context.Process(target=_carrl, args=(list(command), console, barrier.wait), daemon=True)
        for command, console in zip(commands, consoles, strict=True)
    ]
    for process in processes:
        process.start()
    for process in processes:
        process.join(LONGEST_S)
    if any(process.exitcode is None for process in processes):
        for process in processes:
            process.kill()
        raise BenchError(f"a command did not end within {LONGEST_S:.0f} s")
    texts = [console.read_text(encoding="utf-8", errors="replace") for console in consoles]
    return [(int(process.exitcode or 0), text) for process, text in zip(processes, texts, strict=True)]


def _carrl(arguments: list[str], console: Path, wait: Callable[[], Any]) -> None:
    from carrl.cli.main import main

    with ExitStack() as stack:
        file = stack.enter_context(console.open("w", encoding="utf-8"))
        stack.enter_context(redirect_stdout(file))
        stack.enter_context(redirect_stderr(file))
        wait()
        code = main(arguments)
    sys.exit(code)


def _run_alone(folder: Path, command: Sequence[str]) -> None:
    [(code, printed)] = start_together(folder, [command])
    if code != 0:
        raise BenchError(f"`carrl {' '.join(command)}` failed: {last_line(printed)}")


def _commands(kind: str, wanted: Path, references: References) -> list[list[str]]:
    """What the two are asked to do; all want the same folder or file."""
    train = ["train", *references.overrides]
    if kind == RUN:
        return [[*train, f"seed={seed}", f"hydra.run.dir={wanted}"] for seed in SEEDS]
    if kind == RESUME:
        shutil.copytree(references.begun, wanted)
        frames = references.overrides[-1]
        return [["train", f"resume={wanted}", frames]] * 2
    if kind == SWEEP:
        return [["train", "-m", *references.overrides, f"seed={SEEDS[0]},{SEEDS[1]}", f"hydra.sweep.dir={wanted}"]] * 2
    return [["log", "recover", str(references.damaged), str(wanted.with_suffix(".mcap"))]] * 2


def _losses(kind: str, wanted: Path, winner: int, references: References) -> Iterator[str]:
    """What is not as the command leaves it that nobody disturbs."""
    if kind == RUN:
        yield from differences(read_run(wanted), references.runs[SEEDS[winner]])
    elif kind == RESUME:
        yield from differences(read_run(wanted), references.resumed)
    elif kind == SWEEP:
        yield from _losses_of_sweep(wanted, references)
    else:
        recovered = wanted.with_suffix(".mcap")
        verify(recovered)
        if read_contents(recovered) != references.recovered:
            yield "what was recovered is not what a recovery alone recovers"
        others = {path.name for path in wanted.parent.iterdir()} - {recovered.name, "console-0.txt", "console-1.txt"}
        if others:
            yield f"left over: {', '.join(sorted(others))}"


def _losses_of_sweep(sweep: Path, references: References) -> Iterator[str]:
    states = [note.state for note in SweepFolder(sweep).notes().values()]
    if states != ["finished"] * len(SEEDS):
        yield f"the jobs are not finished but {json.dumps(states)}"
    if (found := {path.name for path in sweep.iterdir()}) != {"multirun.yaml", *(f"seed={seed}" for seed in SEEDS)}:
        yield f"the sweep's folder has {', '.join(sorted(found))}"
    for seed in SEEDS:
        job = read_run(sweep / f"seed={seed}")
        yield from differences(replace(job, files=job.files - {JOB}), references.runs[seed])
