"""Lets one of TorchRL's losses compute with other tensors than its own."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from tensordict import TensorDict, TensorDictParams
from torch import Tensor
from torchrl.objectives import LossModule

from carrl.algorithms.algorithm import Tree


@contextmanager
def standing_in(
    loss: LossModule, networks: Mapping[str, Tree], numbers: Mapping[str, Tensor] | None = None
) -> Iterator[None]:
    """Lets the loss compute with these tensors; `torch.func.functional_call` on a LossModule raises in torchrl 0.14.

    Args:
        loss: of any kind.
        networks: tensors by key for each of its groups of parameters, such as `value_network_params`.
        numbers: for its parameters that belong to no network, such as `log_alpha`.
    """
    numbers = numbers or {}
    own = {name: loss._modules[name] for name in networks}
    own_numbers = {name: loss._parameters[name] for name in numbers}
    try:
        forget_cached(loss)
        for name, tensors in networks.items():
            # as many batch dimensions as its own: those of several critics are stacked, and mapped over
            loss._modules[name] = TensorDict(dict(tensors), own[name].batch_size)
        loss._parameters.update(numbers)
        yield
    finally:
        loss._modules.update(own)
        loss._parameters.update(own_numbers)
        forget_cached(loss)


def forget_cached(loss: LossModule) -> None:
    """Lets a loss look at its parameters anew.

    TorchRL 0.14's SACLoss, TD3Loss and DDPGLoss keep detached ones from the first call on, and so do tensordict 0.14's
    parameters themselves. They would go on with those where other tensors stand in, or where parameters have moved to
    other memory, and no error would tell.
    """
    loss.__dict__["_cache"] = {}
    for parameters in loss._modules.values():
        if isinstance(parameters, TensorDictParams):
            parameters._erase_cache()
