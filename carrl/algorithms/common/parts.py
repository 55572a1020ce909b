"""Which of CarRL's own parts go together."""

from collections.abc import Mapping
from typing import Any

from carrl.errors import ConfigError

_ACTOR_CRITIC = "carrl.algorithms.actor_critic."
_ALGORITHMS = "carrl.algorithms."


def check_parts(config: Mapping[str, Any], remedies: Mapping[str, str], *, actor_critic: bool) -> None:
    """Raises ConfigError where a part is that of another algorithm.

    Args:
        config: of the run.
        remedies: what to set for each part that algorithms do not share, such as "network=actor_critic".
        actor_critic: whether the algorithm has actors and critics; else it is DQN.
    """
    for name, remedy in remedies.items():
        node = config.get(name)
        target = str(node.get("_target_", "")) if isinstance(node, Mapping) else ""
        if target.startswith(_ALGORITHMS) and target.startswith(_ACTOR_CRITIC) != actor_critic:
            kind = "DDPG, TD3 or SAC" if actor_critic else "DQN and its descendants"
            raise ConfigError(f"{name} is {target.rpartition('.')[2]}, which is no part of {kind}; set {remedy}")
