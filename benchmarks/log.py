"""`scripts/bench log`: how fast a log of driven transitions is written and read, and how much memory reading takes."""

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict

from benchmarks import figures
from benchmarks.log_reading import READINGS, THROUGH_ALL
from benchmarks.log_share import SHARE_HEADER, share_rows
from benchmarks.options import Parser, positive, tell
from carrl.algorithms.common.network import make_q_network
from carrl.algorithms.dqn.dqn import dqn_columns
from carrl.data.description import log_schema
from carrl.data.source import EpisodeTracker
from carrl.env.track_env import TrackEnv
from carrl.evaluation.baselines import rule_policy
from carrl.log import load
from carrl.log.messages import Episode
from carrl.log.writer import LogWriter
from carrl.task.episode import Start

SCHEMA = log_schema(TrackEnv().task, dqn_columns(("forward", "left", "right")))
HEADER = ("what", "transitions", "seconds", "transitions/s", "bytes each", "peak MiB")
CARS = 64
BATCH = 2048
COPIES = 10
"""How many times as many transitions the large log has."""
EPSILON = 0.5
"""With half of the actions drawn at random an episode lasts about as long as in the paper's run."""


@dataclass(frozen=True)
class Measurement:
    """One row of the table; None where there is nothing to tell.

    Attributes:
        what: was done.
        transitions: that it was done with.
        seconds: of the processor.
        bytes_each: size of the file for each transition.
        peak_bytes: greatest resident memory of a process that does nothing else.
    """

    what: str
    transitions: int
    seconds: float
    bytes_each: float | None = None
    peak_bytes: int | None = None

    @property
    def reads_or_writes_all(self) -> bool:
        """Whether every transition passed, so that there is a speed to tell."""
        return self.peak_bytes is None or self.what == THROUGH_ALL


def main(argv: list[str] | None = None) -> int:
    """Measures and prints; returns 0, or 1 if what was loaded is not what was written."""
    parser = Parser(prog="scripts/bench log", description=__doc__)
    parser.add_argument("--transitions", type=positive(int), default=1_000_000, metavar="N")
    parser.add_argument("--training", action="store_true", help="measure the share of training that logging takes")
    parser.add_argument("--markdown", action="store_true", help="print a table for a page")
    arguments = parser.parse_args(argv)
    torch.set_num_threads(1)
    table = figures.markdown_table if arguments.markdown else figures.plain_table
    if arguments.training:
        print(table(SHARE_HEADER, share_rows()))
        return 0
    tell(f"driving {arguments.transitions:,} transitions")
    transitions, episodes = rollout_laps(int(arguments.transitions))
    with tempfile.TemporaryDirectory() as folder:
        rows, same = measure(Path(folder), transitions, episodes)
    print(table(HEADER, [_row(row) for row in rows]))
    if not same:
        print("what was loaded differs from what was written")
    return int(not same)


def rollout_laps(count: int) -> tuple[TensorDict, list[Episode]]:
    """So many transitions of cars that the rule drives, with the values of an untrained network, and their episodes."""
    env = TrackEnv("paper", num_envs=CARS, seed=0, start=Start(anywhere=True))
    generator = torch.Generator().manual_seed(0)
    network = make_q_network([16, 16, 8], observation_size=7, action_count=3, generator=generator)
    tracker = EpisodeTracker(1, CARS, env.track.gate_count, env.simulator.vehicle.time_step)
    episodes: list[Episode] = []
    steps = []
    state = env.reset()
    with torch.no_grad():
        for _ in range(-(-count // CARS)):
            step, state = env.step_and_maybe_reset(_choose(network(state), env))
            batch = step[:, None]
            episodes += tracker.follow(batch)[0]
            steps.append(batch[:, 0].select(*SCHEMA.keys))
    return torch.cat(steps)[:count], episodes


def _choose(state: Any, env: TrackEnv) -> Any:
    """The rule's actions, and random ones with the marks that exploration leaves in a run."""
    exploratory = torch.rand(CARS) < EPSILON
    by_rule = rule_policy(state["observation"])
    state["action"] = torch.where(exploratory, env.rand_action()["action"], by_rule)
    state["exploratory"] = exploratory
    state["epsilon"] = torch.full((CARS,), EPSILON)
    return state


def measure(folder: Path, transitions: TensorDict, episodes: list[Episode]) -> tuple[list[Measurement], bool]:
    """The rows of the table, and whether all that was loaded is bit for bit what was written."""
    count = len(transitions)
    log, large = folder / "log.mcap", folder / "large.mcap"
    rows = [_timed("write and close", count, lambda: _write(log, transitions, episodes, copies=1), log)]
    rows.append(_timed("load as a TensorDict", count, lambda: load(log)))
    same = _equal(load(log), transitions)
    tell(f"writing {COPIES * count:,} transitions")
    rows.append(_timed("write and close", COPIES * count, lambda: _write(large, transitions, episodes, COPIES), large))
    for verb in READINGS:
        rows.append(_in_own_process(verb, COPIES * count, large))
    return rows, same


def _write(path: Path, transitions: TensorDict, episodes: list[Episode], copies: int) -> None:
    span = int(transitions["time_ns"][-1]) + 100_000_000
    numbers = int(transitions["episode"].max()) + 1
    with LogWriter(path, schema=SCHEMA, attachments={}, metadata={}) as writer:
        for copy in range(copies):
            for batch in transitions.split(BATCH):
                shifted = batch.copy()
                shifted["time_ns"] = batch["time_ns"] + copy * span
                shifted["episode"] = batch["episode"] + copy * numbers
                writer.write(shifted)
            for episode in _shifted(episodes, copy * numbers, copy * span):
                writer.write_episode(episode)


def _shifted(episodes: list[Episode], numbers: int, span: int) -> Iterator[Episode]:
    for episode in episodes:
        begin, end = episode.begin_ns + span, episode.end_ns + span
        yield episode._replace(episode=episode.episode + numbers, begin_ns=begin, end_ns=end)


def _equal(loaded: TensorDict, written: TensorDict) -> bool:
    return all(loaded[key].numpy().tobytes() == written[key].contiguous().numpy().tobytes() for key in SCHEMA.keys)


def _timed(what: str, count: int, work: Callable[[], object], file: Path | None = None) -> Measurement:
    began = time.process_time()
    work()
    seconds = time.process_time() - began
    return Measurement(what, count, seconds, file.stat().st_size / count if file else None)


def _in_own_process(verb: str, count: int, path: Path) -> Measurement:
    """What `benchmarks.log_reading` says of reading in this way."""
    finished = subprocess.run(
        [sys.executable, "-m", "benchmarks.log_reading", verb, str(path)], capture_output=True, text=True, check=True
    )
    seconds, peak = finished.stdout.split()
    return Measurement(verb, count, float(seconds), peak_bytes=int(peak))


def _row(row: Measurement) -> list[str]:
    return [
        row.what,
        f"{row.transitions:,}",
        f"{row.seconds:.2f}",
        f"{row.transitions / row.seconds:,.0f}" if row.reads_or_writes_all else "",
        "" if row.bytes_each is None else f"{row.bytes_each:.1f}",
        "" if row.peak_bytes is None else f"{row.peak_bytes / 2**20:,.0f}",
    ]


if __name__ == "__main__":
    sys.exit(main())
