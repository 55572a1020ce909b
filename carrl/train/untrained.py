"""What baselines drive where nothing was trained: the car, sensors and tracks that a run would have."""

import re
from collections.abc import Sequence
from pathlib import Path

from carrl.errors import ConfigError
from carrl.evaluation.asked import PolicyName
from carrl.train.composition import composed
from carrl.train.overrides import check_is_read, readable_overrides
from carrl.train.run import Run

READ = ("experiment", "track", "vehicle", "sensor", "reward", "opponents")
"""Groups of the configuration that baselines and their figures depend on."""
READ_KEYS = ("env.cars_per_world", "start.gap")
"""Keys of further groups, of the opponents."""
READ_BY_CHANCE = ("action", "seed")
"""Those that the random policy depends on, too."""
OWN_ACTIONS = {"_target_": "carrl.task.action.ContinuousActions"}
"""Of the baselines that choose their actions themselves; they fit every car."""


class Untrained(Run):
    """A run that was never begun: it has no folder and no networks, and its `evaluate` knows the baselines alone.

    Args:
        policy: the baseline that is to drive.
        overrides: of the default configuration, as `carrl train` takes them.

    Raises:
        ConfigError: an override cannot be read, or nothing that the baseline does depends on it.
    """

    def __init__(self, policy: PolicyName, overrides: Sequence[str] = ()) -> None:
        read = (*READ, *(READ_BY_CHANCE if policy == "random" else ()))
        for override in overrides:
            key = re.split("[=@]", override.lstrip("+~"))[0]
            if key.split(".")[0] not in read and key not in READ_KEYS:
                raise ConfigError(
                    f"{override} has no effect on what the {policy} policy does; leave it out, or set one of: "
                    f"{', '.join((*read, *READ_KEYS))}"
                )
        readable = readable_overrides(overrides, is_sweep=None, verb="carrl evaluate", folder_key="RUN")
        config = composed(readable)
        check_is_read(readable, config)
        self.folder = Path()
        self._trust, self._folders, self._has_seeds = (), [self.folder], False
        self._configs = [config if policy == "random" else config | {"action": OWN_ACTIONS}]
