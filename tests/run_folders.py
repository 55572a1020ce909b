"""Writes the folders that training leaves, in milliseconds and with figures of one's choice."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

CONFIG: dict[str, Any] = {
    "track": {"name_or_path": "paper"},
    "vehicle": {"speed": 10.0},
    "action": {"names": ["forward", "left", "right"]},
    "sensor": {"rays": 7},
    "observation": {"rays": {}},
    "reward": {"collision": {"weight": -200.0}, "gate": {"weight": 50.0}},
    "start": {"anywhere": False},
    "env": {"num_envs": 8},
    "network": {"hidden_sizes": [16, 16, 8]},
    "loss": {"gamma": 0.95, "double_dqn": False},
    "trainer": {"episodes": 300, "frames": 1000, "seeds": None},
    "data": {},
    "seed": 0,
}
LOSSES: dict[str, dict[str, Any]] = {
    "dqn": {"gamma": 0.95, "double_dqn": False},
    "double_dqn": {"gamma": 0.95, "double_dqn": True},
    "cql": {"gamma": 0.95, "double_dqn": True, "alpha": 1.0},
}
DRIVE = {
    "lap_completed": True,
    "lap_reward": 400.0,
    "lap_steps": 240,
    "forward_share": 0.6,
    "switches_per_100m": 40.0,
    "reversals": 0,
    "near_wall_share": 0.0,
    "progress": 1.0,
}
METRICS_HEADER = "episode,frame,episode_return,mean_return_20\n"


def write_config(folder: Path, seed: int = 0, **parts: Any) -> Path:
    """A run that has begun, and no more; `parts` replace those of the configuration."""
    path = folder / ".hydra" / "config.yaml"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(yaml.safe_dump(CONFIG | {"seed": seed} | parts))
    return folder


def write_hydra(folder: Path, overrides: list[str], job: int = 0, **options: str) -> None:
    """What Hydra notes of how a run was asked for."""
    hydra = {"hydra": {"job": {"num": job}, "runtime": {"choices": {"hydra/launcher": "basic", **options}}}}
    (folder / ".hydra").mkdir(parents=True, exist_ok=True)
    (folder / ".hydra" / "hydra.yaml").write_text(yaml.safe_dump(hydra))
    (folder / ".hydra" / "overrides.yaml").write_text(yaml.safe_dump(overrides))


def write_run(
    folder: Path,
    seed: int = 0,
    first_lap: int | None = 500,
    returns: tuple[float, ...] = (-200.0, -100.0),
    frames: int = 1000,
    drive: dict[str, Any] | None = None,
    **parts: Any,
) -> Path:
    """A run that has ended, with these returns of episodes of 100 frames each, and these figures of its best drive."""
    write_config(folder, seed, **parts)
    lap = None if first_lap is None else {"episode": 1, "frame": first_lap, "wall_time_s": first_lap / 100}
    best = DRIVE | ({"lap_completed": False, "progress": 0.5} if first_lap is None else {}) | (drive or {})
    summary = {
        "seed": seed,
        "episodes": len(returns),
        "frames": frames,
        "updates": frames,
        "wall_time_s": frames / 100,
        "first_lap": lap,
        "evaluation": best,
    }
    (folder / "summary.json").write_text(json.dumps(summary))
    rows = [f"{index},{100 * (index + 1)},{value},{value}\n" for index, value in enumerate(returns)]
    (folder / "metrics.csv").write_text(METRICS_HEADER + "".join(rows))
    reward = 400.0 - (first_lap or frames) / 10
    write_evaluations(folder, [(frames // 2, False, reward - 100), (frames, best["lap_completed"], reward)])
    return folder


def write_evaluations(folder: Path, trials: Sequence[tuple[int, bool, float]]) -> None:
    """Frames, whether the lap was completed, and its reward, of networks that were tried out in training."""
    rows = [f"{frame},{lapped},{reward}\n" for frame, lapped, reward in trials]
    (folder / "evaluations.csv").write_text("frames,lap_completed,lap_reward\n" + "".join(rows))


def write_offline_run(folder: Path, seed: int = 0, updates: int = 500, **drive: Any) -> Path:
    """A run that has learnt from logs, which had no episodes."""
    write_run(folder, seed, frames=0, drive=drive, data={"path": "train.mcap", "updates": 500})
    summary = json.loads((folder / "summary.json").read_text())
    (folder / "summary.json").write_text(
        json.dumps(summary | {"first_lap": None, "transitions": 1000, "updates": updates})
    )
    (folder / "metrics.csv").write_text("updates,loss\n500,1.0\n")
    (folder / "evaluations.csv").unlink()
    return folder


def write_sweep(root: Path, first_laps: dict[str, list[int | None]]) -> Path:
    """A multirun over losses, each with the seeds 0, 1, ... and these first laps."""
    for job, (loss, laps) in enumerate(first_laps.items()):
        folder = root / f"loss={loss}"
        write_hydra(folder, [f"loss={loss}", f"trainer.seeds=[0..{len(laps) - 1}]"], job, loss=loss)
        trainer = CONFIG["trainer"] | {"seeds": [f"0..{len(laps) - 1}"]}
        write_config(folder, loss=LOSSES[loss], trainer=trainer)
        for seed, lap in enumerate(laps):
            write_run(folder / f"seed={seed}", seed, lap, loss=LOSSES[loss])
    return root
