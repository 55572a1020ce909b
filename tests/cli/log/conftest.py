"""A small finished log, written by hand: three cars on a square, eight episodes of which five ended."""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from carrl.cli.main import main
from carrl.log.codec import tensordict_of
from carrl.log.messages import Episode, Metrics
from carrl.log.scene import ObservationPart, Scene
from carrl.log.writer import LogWriter
from tests.logs import make_schema

ROUNDS = 18
DRIVES = {
    0: [(5, 0, "collision"), (9, 3, "time limit"), (4, 0, None)],
    1: [(7, 1, "collision"), (6, 0, "collision"), (5, 0, None)],
    2: [(12, 4, "time limit"), (6, 0, None)],
}
"""What each car did, one after the other: steps, gates passed, how it ended. Numbers count by the begin:

    car 0: episodes 0, 3, 7 with returns -200, 150; car 1: 1, 4, 6 with -150, -200; car 2: 2, 5 with 200.
"""
SCENE = Scene(
    action_names=("forward", "left", "right"),
    control_names=("steer",),
    observation=(ObservationPart("rays", 5, 0.0, 1.0),),
    reward_terms=("collision", "proximity", "gate", "steering"),
    sensor_angles=np.linspace(-np.pi / 2, np.pi / 2, 5),
    sensor_range=10.0,
    time_step=0.1,
    body_radius=0.5,
    tracks=(),
)
TRACK = {
    "name": "square",
    "length": 56.0,
    "centreline": [[10, 3], [17, 3], [17, 17], [3, 17], [3, 3]],
    "walls": [
        *([[6, 6], [14, 6]], [[14, 6], [14, 14]], [[14, 14], [6, 14]], [[6, 14], [6, 6]]),
        *([[0, 0], [20, 0]], [[20, 0], [20, 20]], [[20, 20], [0, 20]], [[0, 20], [0, 0]]),
    ],
    "gates": [[[14, 10], [20, 10]], [[10, 14], [10, 20]], [[6, 10], [0, 10]], [[10, 6], [10, 0]]],
}
SCHEMA = make_schema(5)
METADATA = {"seed": "3", "track": "square", "num_envs": "3", "packages": '{"carrl": "0.1.0"}', "git_commit": "abc123"}


@dataclasses.dataclass(frozen=True)
class Drive:
    """One episode: which car drives it, from which round on, and how it goes."""

    car: int
    begin: int
    length: int
    gates: int
    ended: str | None

    @property
    def rewards(self) -> np.ndarray:
        """Terms of the reward, [length, 4]: the gates in the last steps but one, then perhaps a collision."""
        terms = np.zeros((self.length, 4))
        terms[self.length - 1 - self.gates : self.length - 1, 2] = 50
        terms[-1, 0] = -200 * (self.ended == "collision")
        return terms


def drives() -> list[Drive]:
    """All episodes in the order of their numbers."""
    found = []
    for car, listed in DRIVES.items():
        begins = np.cumsum([0, *(length for length, _, _ in listed)])
        found += [Drive(car, int(begin), *rest) for begin, rest in zip(begins, listed, strict=False)]
    return sorted(found, key=lambda drive: (drive.begin, drive.car))


def columns_of(round_index: int, tracks: int) -> dict[str, np.ndarray]:
    """The transitions of all cars in one round, [3, ...]; of the second car's Q-values some are no numbers."""
    rows = []
    for number, drive in enumerate(drives()):
        step = round_index - drive.begin
        if 0 <= step < drive.length:
            last = step == drive.length - 1
            rows.append((number, drive, step, drive.rewards[step], last and drive.ended))
    rows.sort(key=lambda row: row[1].car)
    cars = np.array([drive.car for _, drive, *_ in rows])
    steps = np.array([step for _, _, step, *_ in rows])
    terms = np.array([reward for *_, reward, _ in rows], dtype=np.float32)
    passed = np.array([int((drive.rewards[:step, 2] > 0).sum()) for _, drive, step, *_ in rows])
    states = np.stack([10 + 0.5 * steps, 3 + 0.5 * cars, np.zeros(3)], axis=1).astype(np.float32)
    readings = np.linspace(0.2, 0.6, 5) + 0.01 * steps[:, None]
    values = 10.0 + 0.1 * steps[:, None] + np.arange(3)
    values[(cars == 1) & (steps == 2)] = np.nan, np.inf, -np.inf
    return {
        "observation": readings.astype(np.float32),
        "action": steps % 3,
        "reward": terms.sum(axis=1, keepdims=True),
        "reward_terms": terms,
        "next_observation": (readings + 0.01).astype(np.float32),
        "terminated": np.array([[ended == "collision"] for *_, ended in rows]),
        "truncated": np.array([[ended == "time limit"] for *_, ended in rows]),
        "episode": np.array([number for number, *_ in rows]),
        "step": steps,
        "car": cars,
        "state": states,
        "next_state": states + np.array([0.5, 0, 0], dtype=np.float32),
        "next_gate": passed % 4,
        "gates_passed": passed,
        "next_gates_passed": passed + (terms[:, 2] > 0),
        "action_value": values.astype(np.float32),
        "epsilon": np.full(3, 0.1, dtype=np.float32),
        "exploratory": steps % 4 == 3,
        "track": cars % tracks,
        "time_ns": np.full(3, 100_000_000 * round_index),
    }


def ended_in(round_index: int, tracks: int) -> list[Episode]:
    """The episodes that end with this round."""
    return [
        Episode(
            episode=number,
            env=drive.car,
            track=drive.car % tracks,
            frame=3 * (round_index + 1),
            begin_ns=100_000_000 * drive.begin,
            end_ns=100_000_000 * (round_index + 1),
            episode_return=float(drive.rewards.sum()),
            length=drive.length,
            gates=drive.gates,
            laps=drive.gates // 4,
            ended=drive.ended,  # type: ignore[arg-type]
            end_pose=(10 + 0.5 * drive.length, 3.0, 0.0),
        )
        for number, drive in enumerate(drives())
        if drive.ended and drive.begin + drive.length == round_index + 1
    ]


def write_log(path: Path, track_names: tuple[str, ...] = ("square",), scene: Scene = SCENE, **recorder: int) -> Path:
    """Writes the log; `recorder` are further arguments of the LogWriter."""
    names = [f"track-{index}.json" if index else "track.json" for index in range(len(track_names))]
    tracks = {name: json.dumps({**TRACK, "name": track}) for name, track in zip(names, track_names, strict=True)}
    attachments = {"config.yaml": b"seed: 3\n", **{name: text.encode() for name, text in tracks.items()}}
    metadata = {**METADATA, "track": track_names[0], **scene.entries()}
    schema = make_schema(5, terms=scene.reward_terms)
    with LogWriter(path, schema=schema, attachments=attachments, metadata=metadata, **recorder) as writer:
        for index in range(ROUNDS):
            writer.write(tensordict_of(columns_of(index, len(track_names)), schema))
            for episode in ended_in(index, len(track_names)):
                writer.write_episode(episode)
            if index % 6 == 5:
                loss = np.nan if index == 5 else 1.0
                writer.write_metrics(
                    Metrics(
                        3 * (index + 1), index, loss, 1000.0, {"td_error": 0.5, "action_value": 10.0, "epsilon": 0.1}
                    )
                )
    return path


@pytest.fixture(scope="session")
def log_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """54 transitions, to be read only."""
    return write_log(tmp_path_factory.mktemp("run") / "train.mcap")


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Runs a verb of `carrl log` that succeeds, and returns what it printed."""

    def run_verb(*arguments: object) -> str:
        assert main(["log", *map(str, arguments)]) == 0
        printed = capsys.readouterr()
        assert printed.err == ""
        return printed.out

    return run_verb


@pytest.fixture
def refused(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Runs a verb of `carrl log` that refuses its input, and returns its one sentence."""

    def run_verb(*arguments: object) -> str:
        assert main(["log", *map(str, arguments)]) == 2
        printed = capsys.readouterr()
        assert printed.out == ""
        (line,) = printed.err.splitlines()
        assert line.startswith("carrl: ")
        return line.removeprefix("carrl: ")

    return run_verb
