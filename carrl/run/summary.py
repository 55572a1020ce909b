"""A run in a few figures: what `summary.json` holds."""

from dataclasses import asdict
from typing import Any

from carrl.run.evaluation import Drive
from carrl.run.trainer import Trainer

EVALUATION_KEYS = (
    "lap_completed",
    "lap_reward",
    "lap_steps",
    "forward_share",
    "switches_per_100m",
    "near_wall_share",
    "progress",
)


def summarise(trainer: Trainer, **context: Any) -> dict[str, Any]:
    """The run's figures; `evaluation` is of the best greedy drive, whose policy is `checkpoints/best.pt`.

    Args:
        trainer: after its run.
        context: what else to note of the run, such as its seed.
    """
    return {
        **context,
        "episodes": trainer.episodes,
        "frames": trainer.frames,
        "updates": trainer.updates,
        "wall_time_s": round(trainer.wall_time_s, 3),
        "first_lap": asdict(trainer.first_lap) if trainer.first_lap else None,
        "evaluation": _figures(trainer.best),
        "last_evaluation": _figures(trainer.last),
    }


def _figures(attempt: Drive | None) -> dict[str, Any] | None:
    return None if attempt is None else {key: attempt.measures()[key] for key in EVALUATION_KEYS}
