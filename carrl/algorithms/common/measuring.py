"""What measuring has in common.

Shapes: `F` transitions.
"""

from tensordict import TensorDictBase

MOST_MEASURED = 256
"""Of more transitions than these an even sample is measured, so that it takes little time."""


def thinned(transitions: TensorDictBase) -> TensorDictBase:
    """An even sample of transitions [F], to which may be added without changing them."""
    return transitions[:: -(-len(transitions) // MOST_MEASURED)].clone(recurse=False)
