"""A run in a few figures: what `summary.json` holds."""

from dataclasses import asdict
from typing import Any

from carrl.evaluation.results import Trial
from carrl.train.agent_run import AgentRun
from carrl.train.training import Training

EVALUATION_KEYS = (
    "lap_completed",
    "lap_reward",
    "lap_steps",
    "forward_share",
    "switches_per_100m",
    "reversals",
    "near_wall_share",
    "progress",
    "circuits",
    "laps_completed",
)
"""Of several circuits the means, and the last two besides."""


def summarise(run: AgentRun, trainer: Training, **context: Any) -> dict[str, Any]:
    """The run's figures; `evaluation` is of the best greedy drive, whose policy is `checkpoints/best.pt`.

    Args:
        run: that is over, or was interrupted.
        trainer: that it was part of; all times are counted from when it was made.
        context: what else to note of the run, such as its track.
    """
    return {
        "seed": run.agent.seed,
        "finished": not trainer.stopping,
        **context,
        "episodes": run.episodes,
        "frames": run.moment.frames,
        "updates": run.moment.updates,
        "wall_time_s": round(run.moment.wall_time_s, 3),
        "start_up_s": round(trainer.start_up_s, 3),
        "first_update_s": None if trainer.first_update_s is None else round(trainer.first_update_s, 3),
        "first_lap": asdict(run.first_lap) if run.first_lap else None,
        "evaluation": _figures(run.best),
        "last_evaluation": _figures(run.last),
    }


def _figures(attempt: Trial | None) -> dict[str, Any] | None:
    if attempt is None:
        return None
    measures = attempt.measures()
    return {key: measures[key] for key in EVALUATION_KEYS if key in measures}
