"""Who is measured, and how one measurement of each is made."""

import json
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.child import CARRL, BenchError, run_child
from benchmarks.figures import Measurement
from benchmarks.settings import BATCH_SIZE, CARS

SEEDS = 10
MINIMUM_FRAMES = 512
"""So few that they are made at once, yet enough for the first updates and thus for compiling them."""


@dataclass(frozen=True)
class Contestant:
    """Something that trains on the track.

    Attributes:
        name: by which the command line chooses it.
        title: by which the table shows it.
        frames: env steps in one measurement, for each seed; enough for 15 to 25 seconds on a slow core.
        seeds: how many replicates it trains at once.
        train: makes this many env steps with each seed, in a process of its own.
    """

    name: str
    title: str
    frames: int
    seeds: int
    train: Callable[[int], Measurement]

    def measure(self, frames: int) -> Measurement:
        """Trains, and checks that there was one update for each env step, but for the first ones.

        Raises:
            BenchError: it failed, or trained less than the others.
        """
        try:
            measured = self.train(frames)
        except BenchError as error:
            raise BenchError(f"{self.name}: {error}") from error
        missing = measured.frames - measured.updates
        if measured.frames < frames * self.seeds or missing > (BATCH_SIZE + CARS) * self.seeds:
            raise BenchError(
                f"{self.name} made {measured.frames} env steps of {frames} with each of {self.seeds} seeds, and "
                f"{measured.updates} updates; there must be one for each env step, after the first {BATCH_SIZE}"
            )
        return measured


def carrl_overrides(compiled: bool, seeds: int, frames: int, folder: Path | str) -> list[str]:
    """What turns `carrl train`, the paper's run, into this contestant."""
    which = f"trainer.seeds=[{','.join(map(str, range(seeds)))}]" if seeds > 1 else "seed=0"
    return [f"compile={str(compiled).lower()}", which, f"trainer.frames={frames}", f"hydra.run.dir={folder}"]


def _train_carrl(compiled: bool, seeds: int, frames: int) -> Measurement:
    with tempfile.TemporaryDirectory() as name:
        _, errors = run_child([*CARRL, *carrl_overrides(compiled, seeds, frames, name)])
        warned = [line.strip() for line in errors.splitlines() if "eagerly" in line]
        if compiled and warned:
            raise BenchError(warned[0])
        return read_run(Path(name), seeds)


def read_run(folder: Path, seeds: int) -> Measurement:
    """The figures of a run's folder: of all its seeds together, from the trainer's making to the end of the last.

    Raises:
        BenchError: there are not as many summaries as seeds.
    """
    files = sorted(folder.glob("seed=*/summary.json")) if seeds > 1 else [folder / "summary.json"]
    if len(files) != seeds or not all(file.is_file() for file in files):
        raise BenchError(f"the run's folder has {len(files)} summary.json; it must have one for each of {seeds} seeds")
    summaries: list[dict[str, Any]] = [json.loads(file.read_text(encoding="utf-8")) for file in files]
    return Measurement(
        frames=sum(summary["frames"] for summary in summaries),
        updates=sum(summary["updates"] for summary in summaries),
        seconds=max(summary["wall_time_s"] for summary in summaries),
    )


def _train_peer(name: str, frames: int) -> Measurement:
    output, _ = run_child(["-m", "benchmarks.peers", name, "--frames", str(frames)])
    return Measurement(**json.loads(output.splitlines()[-1]))


def _carrl(name: str, title: str, frames: int, *, compiled: bool, seeds: int) -> Contestant:
    return Contestant(name, title, frames, seeds, partial(_train_carrl, compiled, seeds))


def _peer(name: str, title: str, frames: int) -> Contestant:
    return Contestant(name, title, frames, 1, partial(_train_peer, name))


SB3 = {
    "sb3-one-car": "Stable-Baselines3 DQN, one car through Gymnasium",
    "sb3-many-cars": f"Stable-Baselines3 DQN, {CARS} cars in one batched VecEnv",
}
CONTESTANTS = {
    each.name: each
    for each in (
        _carrl("compiled", "CarRL, compiled, one seed", 100_000, compiled=True, seeds=1),
        _carrl("eager", "CarRL, eager, one seed", 8_000, compiled=False, seeds=1),
        _carrl("compiled-ten", "CarRL, compiled, ten seeds at once", 40_000, compiled=True, seeds=SEEDS),
        _carrl("eager-ten", "CarRL, eager, ten seeds at once", 1_000, compiled=False, seeds=SEEDS),
        _peer("sb3-one-car", SB3["sb3-one-car"], 10_000),
        _peer("sb3-many-cars", SB3["sb3-many-cars"], 20_000),
        _peer("plain-loop", "plain PyTorch loop (as CleanRL does it), one car", 15_000),
    )
}
