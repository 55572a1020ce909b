"""Files of a run's folder: configuration, checkpoint, results."""

import io
import json
import os
import pickle
from functools import cached_property
from pathlib import Path
from random import Random
from typing import Any

import torch
import yaml
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from benchmarks.fuzz.mutation import NUMBERS, mutate
from benchmarks.fuzz.parser import Parser
from benchmarks.fuzz.values import VALUES, change
from carrl.config import config_dir
from carrl.errors import CarrlError
from carrl.report.findings import find
from carrl.report.runs import DAMAGED
from carrl.report.text import report_text
from carrl.train.build import build_network, build_world, load_greedy_policy
from carrl.train.checkpoint import FORMAT_VERSION
from carrl.train.files import CONFIG, METRICS, SUMMARY, checkpoint_path, load_config
from carrl.train.plan import checked_seed

_READ = (
    "track",
    "vehicle",
    "action",
    "sensor",
    "observation",
    "reward",
    "start",
    "env",
    "network",
    "seed",
    "opponents",
    "end",
)


class RunParser(Parser):
    """A parser of a run's folder."""

    def __init__(self, folder: Path) -> None:
        """Makes a folder as a run leaves it."""
        super().__init__(folder)
        for path in (folder / CONFIG, checkpoint_path(folder, "best")):
            path.parent.mkdir(parents=True)
        (folder / CONFIG).write_text(yaml.safe_dump(self.configs[0]))

    @cached_property
    def configs(self) -> list[dict[str, Any]]:
        """What evaluations read of several runs' configurations."""
        overrides = (
            [],
            ["track=random", "vehicle=bicycle"],
            ["experiment=smooth", "track=oval", "sensor.noise=0.1"],
            ["experiment=traffic", "track=oval"],
        )
        with initialize_config_dir(str(config_dir()), version_base="1.3"):
            whole = [OmegaConf.to_container(compose("train", each), resolve=True) for each in overrides]
        return [{key: config[key] for key in _READ} for config in whole]  # type: ignore[call-overload, index]


class RunConfig(RunParser):
    """`.hydra/config.yaml`, as `carrl evaluate` reads it."""

    def make(self, draw: Random) -> None:
        """A configuration with values or the text changed."""
        values: Any = draw.choice(self.configs)
        for _ in range(draw.choice((0, 1, 1, 2, 3))):
            values = change(draw, values)
        text = yaml.dump(values).encode()
        (self.folder / CONFIG).write_bytes(text if draw.random() < 0.7 else mutate(draw, text, [text, b"&a [*a]"]))

    def feed(self) -> None:
        """Builds what an evaluation needs."""
        config = load_config(self.folder)
        build_network(config, build_world(config))
        checked_seed(config["seed"])


class Touch:
    """Would create a file when unpickled."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __reduce__(self) -> tuple[Any, ...]:
        """What unpickling calls."""
        return os.mkdir, (str(self._path),)


class Checkpoint(RunParser):
    """`checkpoints/best.pt`, as `carrl evaluate` reads it."""

    @cached_property
    def weights(self) -> dict[str, torch.Tensor]:
        """Of a network that fits the configuration."""
        return dict(build_network(self.configs[0], build_world(self.configs[0])).state_dict())

    def make(self, draw: Random) -> None:
        """A checkpoint with values, tensors or bytes changed."""
        state: Any = {"format_version": FORMAT_VERSION, "network": dict(self.weights), "frames": 5}
        for _ in range(draw.choice((0, 1, 1, 2))):
            state = self._change(draw, state)
        content = io.BytesIO()
        torch.save(state, content, _use_new_zipfile_serialization=draw.random() < 0.9)
        if draw.random() < 0.05:
            content = io.BytesIO(pickle.dumps(state))
        written = content.getvalue()
        whole = written if draw.random() < 0.3 else mutate(draw, written, [written])
        checkpoint_path(self.folder, "best").write_bytes(whole)

    def _change(self, draw: Random, state: Any) -> Any:
        if not isinstance(state, dict) or draw.random() < 0.2:
            return change(draw, state) if isinstance(state, dict) else state
        copy, odd = dict(state), self._odd(draw)
        if isinstance(copy.get("network"), dict) and draw.random() < 0.7:
            copy["network"] = {**copy["network"], draw.choice([*self.weights, "more", 7]): odd}
        else:
            copy[draw.choice(("network", "format_version", "more"))] = odd
        return copy

    def _odd(self, draw: Random) -> Any:
        own = self.weights[draw.choice(list(self.weights))]
        return draw.choice(
            (
                lambda: own.double(),
                lambda: own.to_sparse(),
                lambda: own * float("nan"),
                lambda: own.T if own.ndim == 2 else own[:1],
                lambda: own.to(torch.complex64),
                lambda: torch.zeros(1).expand(10**9),
                lambda: torch.empty(0),
                lambda: torch.nn.Parameter(own),
                lambda: torch.empty(own.shape, device="meta"),
                lambda: Touch(self.folder / "harmed"),
                lambda: draw.choice(VALUES),
            )
        )()

    def feed(self) -> None:
        """Loads the network into a policy."""
        try:
            load_greedy_policy(self.folder, "best", self.configs[0], build_world(self.configs[0]))
        finally:
            if (self.folder / "harmed").exists():
                (self.folder / "harmed").rmdir()
                raise AssertionError("the checkpoint ran a command")


class Results(RunParser):
    """`summary.json` and `metrics.csv`, as `carrl report` reads them."""

    def make(self, draw: Random) -> None:
        """Results with values or the text changed."""
        evaluation = {
            **{"lap_completed": True, "lap_reward": 400.0, "lap_steps": 230, "forward_share": 0.5},
            **{"switches_per_100m": 20.5, "reversals": 3, "near_wall_share": 0.1, "progress": 1.0},
        }
        first = {"episode": 5, "frame": 700, "wall_time_s": 3.5}
        summary: Any = {
            **{"seed": 0, "episodes": 100, "frames": 6000, "updates": 5900, "wall_time_s": 3.5},
            **{"first_lap": first, "evaluation": evaluation},
        }
        for _ in range(draw.choice((0, 1, 1, 2, 3))):
            summary = change(draw, summary)
        text = json.dumps(summary).encode()
        (self.folder / SUMMARY).write_bytes(text if draw.random() < 0.7 else mutate(draw, text, [text]))
        rows = [
            f"{episode},{60 * episode},{draw.uniform(-300, 400):.2f},-20.0"
            for episode in range(draw.choice((0, 1, 30)))
        ]
        if rows and draw.random() < 0.3:
            rows[-1] = f"9,{draw.choice(NUMBERS)},{draw.choice(NUMBERS)},x"
        table = "\n".join(["episode,frame,episode_return,mean_return_20", *rows, ""]).encode()
        (self.folder / METRICS).write_bytes(table if draw.random() < 0.7 else mutate(draw, table, [table, b"a,b\n"]))

    def feed(self) -> None:
        """Makes the report, which names a damaged run among its problems."""
        (run,) = (findings := find([self.folder], None)).runs
        report_text(findings, None)
        if run.state == DAMAGED:
            raise CarrlError(run.reason)
