"""What a run that learns from logs leaves in its folder besides what every run does."""

from dataclasses import asdict, dataclass

from carrl.train.folder import RunFolder


@dataclass(frozen=True)
class Learnt:
    """How far an agent has come, measured on a fixed sample of the logged transitions.

    Attributes:
        updates: of its network.
        loss: of the last minibatch, before the update.
        td_error: mean absolute TD error.
        logged_value: mean value of the actions that were taken.
        greedy_value: mean value of the best actions; far above `logged_value`, it is wishful thinking.
        agreement: share of the transitions whose action is the best one.
        wall_time_s: since training began, s.
    """

    updates: int
    loss: float
    td_error: float
    logged_value: float
    greedy_value: float
    agreement: float
    wall_time_s: float


class OfflineRunFolder(RunFolder):
    """A run's folder whose `metrics.csv` has a row for every so many updates, as there are no episodes."""

    def add_learnt(self, learnt: Learnt) -> None:
        """Adds a row to `metrics.csv`."""
        self._metrics.append(
            {name: round(value, 6) if isinstance(value, float) else value for name, value in asdict(learnt).items()}
        )
        self._add_scalars("training", learnt.updates, asdict(learnt))
