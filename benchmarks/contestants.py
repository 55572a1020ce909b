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
from benchmarks.settings import (
    ACTOR_CRITIC_BATCH_SIZE,
    ACTOR_CRITIC_GAMMA,
    ACTOR_CRITIC_RATES,
    BATCH_SIZE,
    CARS,
    TAU,
)

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
        batch_size: transitions of an update.
        peer: the title of the one that its speed is divided by; None for Stable-Baselines3's DQN, of which the faster
            form counts.
    """

    name: str
    title: str
    frames: int
    seeds: int
    train: Callable[[int], Measurement]
    batch_size: int = BATCH_SIZE
    peer: str | None = None

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
        if measured.frames < frames * self.seeds or missing > (self.batch_size + CARS) * self.seeds:
            raise BenchError(
                f"{self.name} made {measured.frames} env steps of {frames} with each of {self.seeds} seeds, and "
                f"{measured.updates} updates; there must be one for each env step, after the first {self.batch_size}"
            )
        return measured


def carrl_overrides(compiled: bool, seeds: int, frames: int, folder: Path | str) -> list[str]:
    """What turns `carrl train`, the paper's run, into this contestant."""
    which = f"trainer.seeds=[{','.join(map(str, range(seeds)))}]" if seeds > 1 else "seed=0"
    return [f"compile={str(compiled).lower()}", which, f"trainer.frames={frames}", f"hydra.run.dir={folder}"]


def _train_carrl(compiled: bool, seeds: int, frames: int, *others: str) -> Measurement:
    with tempfile.TemporaryDirectory() as name:
        _, errors = run_child([*CARRL, *carrl_overrides(compiled, seeds, frames, name), *others])
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


def _train_actor_critic(algorithm: str, units: int, frames: int) -> Measurement:
    overrides = [
        f"loss={algorithm}",
        f"loss.gamma={ACTOR_CRITIC_GAMMA}",
        "loss.actor_rate=1.0",
        f"network.actor_sizes=[{units},{units}]",
        f"network.critic_sizes=[{units},{units}]",
        f"optimizer.lr={ACTOR_CRITIC_RATES[algorithm]}",
        f"target_updater.tau={TAU}",
        f"replay_buffer.batch_size={ACTOR_CRITIC_BATCH_SIZE}",
    ]
    return _train_carrl(True, 1, frames, *overrides)


PEER_FRAMES = 10 * ACTOR_CRITIC_BATCH_SIZE
"""Of Stable-Baselines3's actors and critics, whatever they cost: in the first minibatch's steps nothing is learnt."""


def _pair(algorithm: str, units: int) -> list[Contestant]:
    """CarRL's and Stable-Baselines3's form of an algorithm, with two layers of so many units."""
    suffix = "" if units == 64 else f"-{units}"
    name, layers = algorithm + suffix, f"layers {units}-{units}"
    title = f"Stable-Baselines3 {algorithm.upper()}, {layers}, {CARS} cars in one batched VecEnv"
    shared = {"batch_size": ACTOR_CRITIC_BATCH_SIZE, "peer": title}
    own = partial(_train_actor_critic, algorithm, units)
    return [
        Contestant(name, f"CarRL {algorithm.upper()}, {layers}, compiled", 1_920_000 // units, 1, own, **shared),
        Contestant(f"sb3-{name}", title, PEER_FRAMES, 1, partial(_train_peer, f"sb3-{name}"), **shared),
    ]


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
        *(each for algorithm in ACTOR_CRITIC_RATES for each in _pair(algorithm, 64)),
        *_pair("sac", 256),
    )
}
DQN_CONTESTANTS = [name for name, each in CONTESTANTS.items() if each.peer is None]
