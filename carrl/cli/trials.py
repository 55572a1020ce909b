"""The trials of `carrl tune`: training runs, given up early where they are hopeless."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from carrl.cli.text.console import RoadWarning, StopOnSignals
from carrl.errors import CarrlError, ConfigError
from carrl.train.callbacks import Callback
from carrl.train.composition import composed
from carrl.train.experiment import Experiment
from carrl.train.objectives import Objective

if TYPE_CHECKING:
    from carrl.cli.tune import SearchSpace

ERROR = "error"
"""What a trial that failed keeps of the reason."""


@dataclass(frozen=True)
class Tuning:
    """What is tuned.

    Attributes:
        overrides: of every trial.
        space: what each trial draws besides.
        objective: what is sought.
        folder: of the study; each trial has a run's folder in it.
        own_folder: of groups and experiments of one's own.
    """

    overrides: Sequence[str]
    space: "SearchSpace"
    objective: Objective
    folder: Path
    own_folder: Path | None = None

    def run_trial(self, study: Any) -> None:
        """Draws settings, trains with them, and tells the study what came of it.

        Raises:
            ConfigError: the settings are none that can be trained with.
            KeyboardInterrupt: a signal ended the trial.
        """
        from optuna.trial import TrialState

        trial = study.ask()
        drawn = [f"{key}={values.suggest(trial, key)}" for key, values in self.space.items()]
        try:
            config = composed([*self.overrides, *drawn], self.own_folder)
            config.pop("search")
            pruning = PruningCallback(trial, self.objective, config)
            summaries = Experiment(config, self.folder / f"trial={trial.number}").run(
                [RoadWarning(), StopOnSignals(), pruning]
            )
            if pruning.verdict is None and not all(summary["finished"] for summary in summaries):
                raise KeyboardInterrupt
        except KeyboardInterrupt:
            study.tell(trial, state=TrialState.FAIL)
            raise
        except CarrlError as error:
            trial.set_user_attr(ERROR, str(error))
            study.tell(trial, state=TrialState.FAIL)
            if isinstance(error, ConfigError):
                raise
            return
        if pruning.verdict == "pruned":
            study.tell(trial, state=TrialState.PRUNED)
        else:
            study.tell(trial, pruning.value)


class PruningCallback(Callback):
    """Follows a trial's greedy drives, and ends it as soon as its value is final, or the study's pruner gives it up."""

    def __init__(self, trial: Any, objective: Objective, config: Mapping[str, Any]) -> None:
        self._trial, self._objective = trial, objective
        self._frames, self._interval = config["trainer"]["frames"], config["evaluation"]["interval"]
        self._judged = 0
        self._runs: Sequence[Any] = ()
        self.verdict: str | None = None

    @property
    def value(self) -> float:
        """Of the trial so far."""
        return self._objective.value(self._runs, self._frames)

    def on_round(self, trainer: Any) -> None:
        """Reports the trial's value after every evaluation."""
        self._runs = trainer.runs
        evaluations = trainer.frames // self._interval  # not frames, which differ with env.num_envs
        if evaluations == self._judged:
            return
        self._judged = evaluations
        self._trial.report(self.value, evaluations)
        if self._objective.is_settled(self._runs):
            for later in range(evaluations + 1, self._frames // self._interval + 1):
                self._trial.report(self.value, later)  # so that others are still measured by it
            self.verdict = "converged"
        elif self._trial.should_prune():
            self.verdict = "pruned"
        if self.verdict is not None:
            trainer.stop()
