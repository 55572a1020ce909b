"""The noise of a noisy network's weights.

Shapes: a layer has `I` inputs and `O` outputs.
"""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs.utils import ExplorationType
from torchrl.modules import NoisyLinear
from torchrl.objectives import DQNLoss

from carrl.algorithms.common.network import QNetwork


class WeightNoise:
    """Draws the noise of all noisy layers anew, in the trained network and, apart from it, in the target network.

    TorchRL 0.14's `NoisyLinear.reset_noise` draws from torch's own generator and cannot reach the target network. Noise
    that is drawn before every update stays for the actions until the next one.

    Source: Fortunato et al. 2018, "Noisy Networks for Exploration", eq. 10 and 11, section 3.1.

    Args:
        network: that is trained.
        loss: with both networks. It shares the parameters of the trained one, but has such noise of its own.
        generator: on the CPU.
    """

    def __init__(self, network: QNetwork, loss: DQNLoss, generator: torch.Generator) -> None:
        """Draws for the first time."""
        names = [name for name, layer in network.named_modules() if isinstance(layer, NoisyLinear)]
        acting = [network.get_submodule(name) for name in names]
        self._trained = [
            _Layer(*(_noise_of(loss.value_network_params, name)), (layer.weight_epsilon, layer.bias_epsilon))
            for name, layer in zip(names, acting, strict=True)
        ]
        self._target = [_Layer(*_noise_of(loss.target_value_network_params, name), ()) for name in names]
        loss.deterministic_sampling_mode = ExplorationType.RANDOM  # else its forward pass would be without noise
        self._generator = generator
        self.draw()

    def draw(self) -> None:
        """Draws all noise anew."""
        for layer in (*self._trained, *self._target):
            outputs, inputs = (self._factor(size, layer.weight.device) for size in layer.weight.shape)
            layer.weight.copy_(outputs.outer(inputs))
            layer.bias.copy_(outputs)
            layer.update_followers()

    def state_dict(self) -> dict[str, Tensor]:
        """Where the generator stands; the noise itself is part of the loss's state."""
        return {"generator": self._generator.get_state()}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Goes on from there; call it after the loss has its own state."""
        self._generator.set_state(state["generator"])
        for layer in self._trained:
            layer.update_followers()

    def _factor(self, size: int, device: torch.device) -> Tensor:
        drawn = torch.randn(size, generator=self._generator)
        return (drawn.sign() * drawn.abs().sqrt()).to(device)


class _Layer(NamedTuple):
    """The noise of a layer's weight [O, I] and bias [O], and copies of both that someone else reads."""

    weight: Tensor
    bias: Tensor
    followers: Sequence[Tensor]

    def update_followers(self) -> None:
        for follower, source in zip(self.followers, (self.weight, self.bias), strict=False):
            follower.copy_(source)


def is_noisy(network: torch.nn.Module) -> bool:
    """Whether any of its layers is."""
    return any(isinstance(layer, NoisyLinear) for layer in network.modules())


def _noise_of(parameters: TensorDictBase, name: str) -> tuple[Tensor, Tensor]:
    layer = tuple(name.split("."))
    return parameters[(*layer, "weight_epsilon")], parameters[(*layer, "bias_epsilon")]
