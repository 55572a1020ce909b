"""DQN's updates as machine code, on the tensors of the losses and optimizers that they replace.

Shapes: `A` replicates, `U` updates, `N` transitions of a minibatch.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torchrl.objectives import DQNLoss
from torchrl.objectives.value import TD0Estimator

from carrl.algorithms.algorithm import Tree, UpdateResult
from carrl.algorithms.common.compiled_update import stack_side_by_side
from carrl.algorithms.common.native import CompilationError
from carrl.algorithms.common.network import Power, QNetwork
from carrl.algorithms.common.optimizer import Adam, GradientClipping
from carrl.algorithms.dqn.loss import AdvantageLearningLoss, ConservativeDQNLoss
from carrl.algorithms.dqn.update_kernel import Memory, Parameters, Rule, make_work, update

_STEPS = "steps_to_next_obs"
_LOSSES = (DQNLoss, AdvantageLearningLoss, ConservativeDQNLoss)
MOST_WEIGHTS = 32_768
"""Of a network that is updated by machine code even where there is a C++ compiler, whose matrix products of larger ones
are faster."""


class MachineUpdates:
    """Updates of all replicates, of networks of linear layers with ReLU between them.

    Args:
        network: one of them; all are alike.
        loss: its loss.
        state: `network`, `target` and `adam` of each replicate, as `FunctionalUpdate` has it: the very tensors.
        adam: what the optimizers do.
        clipping: of gradients.
        tau: share of the way that the target network moves after each update; 0 where it is copied elsewhere.
        memory: the transitions, [capacity, A, ...] by key; its tensors stay where they are.
        batch_size: N.

    Raises:
        CompilationError: the network or the loss is of another kind, or not on the CPU.
    """

    def __init__(
        self,
        network: QNetwork,
        loss: DQNLoss,
        state: Sequence[Tree],
        *,
        adam: Adam,
        clipping: GradientClipping | None,
        tau: float,
        memory: Mapping[Any, Tensor],
        batch_size: int,
    ) -> None:
        """Compiles at once, unless that was done before."""
        names, exponent = _linear_layers(network.layers)
        keys = [
            next(key for key in state[0]["network"] if key[-2:] == (name, kind))
            for name in names
            for kind in ("weight", "bias")
        ]
        shapes = [state[0]["network"][key].shape for key in keys]

        def together(*group: str) -> tuple[Tensor, list[int]]:
            trees: list[Any] = [each[group[0]][group[1]] if group[1:] else each[group[0]] for each in state]
            return stack_side_by_side([[tree[key] for key in keys] for tree in trees])

        trained, begins = together("network")
        self._rule = Rule(
            sizes=np.array([shapes[0][1], *(shape[0] for shape in shapes[::2])]),
            offsets=np.array(begins).reshape(-1, 2),
            input_exponent=exponent,
            gamma=float(loss.value_estimator.gamma),
            double_dqn=loss.double_dqn,
            huber=loss.loss_function == "smooth_l1",
            gap_weight=float(loss.alpha) if isinstance(loss, AdvantageLearningLoss) else 0.0,
            excess_weight=float(loss.alpha) if isinstance(loss, ConservativeDQNLoss) else 0.0,
            max_norm=math.inf if clipping is None else float(clipping.max_norm),
            tau=float(tau),
            beta_1=adam.beta_1,
            beta_2=adam.beta_2,
            eps=adam.eps,
        )

        self._parameters = Parameters(
            network=trained.numpy(),
            target=together("target")[0].numpy(),
            mean=together("adam", "exp_avg")[0].numpy(),
            square=together("adam", "exp_avg_sq")[0].numpy(),
            step=together("adam", "step")[0].numpy(),
        )
        self._memory = Memory(
            observation=_array(memory["observation"], torch.float32),
            action=_array(memory["action"], torch.int64),
            next_observation=_array(memory["next", "observation"], torch.float32),
            reward=_array(memory["next", "reward"][..., 0], torch.float32),
            terminated=_array(memory["next", "terminated"][..., 0], torch.bool),
            steps=_array(memory[_STEPS][..., 0] if _STEPS in memory else torch.zeros(0, 0).long(), torch.int64),
        )
        self._work = make_work(self._rule.sizes, batch_size)
        self._all_alike = np.zeros((0, 0, 0), np.float32)
        self(torch.zeros(0, batch_size, len(state)).long(), None, np.zeros(0))

    def __call__(self, items: Tensor, weights: Tensor | None, rates: np.ndarray) -> UpdateResult:
        """Updates on the transitions at these places of the memory, one update after the other.

        Args:
            items: [U, N, A], int64.
            weights: by which they count, [U, N, A], float32; None where they count alike.
            rates: learning rates, [U], float64.

        Returns:
            The losses before each update, [U, A], and the squared TD errors, [U, N, A].
        """
        counts = self._all_alike if weights is None else _array(weights, torch.float32)
        found = update(
            self._rule, self._parameters, self._memory, self._work, _array(items, torch.int64), counts, rates
        )
        return UpdateResult(*map(torch.from_numpy, found))


def weights_of(network: QNetwork) -> int:
    """How many numbers a network has learnt."""
    return sum(parameter.numel() for parameter in network.parameters())


def check_plain(network: QNetwork, loss: DQNLoss) -> None:
    """Raises CompilationError for parts of a user's own, other layers, and what TorchRL's loss can do besides."""
    if type(network) is not QNetwork or type(loss) not in _LOSSES:
        raise CompilationError(f"the network is a {type(network).__name__}, the loss a {type(loss).__name__}")
    _linear_layers(network.layers)
    estimator = loss.value_estimator
    plain = loss.loss_function in ("l2", "smooth_l1") and loss.reduction == "mean" and loss.delay_value
    plain = plain and type(estimator) is TD0Estimator and not estimator.average_rewards
    if not plain or loss.tensor_keys != DQNLoss.default_keys():
        raise CompilationError("the loss has options of its own")


def _linear_layers(layers: nn.Module) -> tuple[list[str], float]:
    """The names of the linear layers, between which there is ReLU, and what observations are raised to before them."""
    # Not `named_children`, which leaves out what is there twice.
    named: list[Any] = [*layers._modules.items()] if isinstance(layers, nn.Sequential) else []
    exponent = 1.0
    if named and isinstance(power := named[0][1], Power):
        exponent = float(power.exponent)
        named = named[1:]
    kinds = [nn.Linear if place % 2 == 0 else nn.ReLU for place in range(len(named))]
    is_alternating = len(named) % 2 and all(type(layer) is kind for (_, layer), kind in zip(named, kinds, strict=True))
    if not is_alternating or not all(map(_learns_all, [layer for _, layer in named[::2]])):
        raise CompilationError("the network is not made of linear layers with ReLU between them")
    return [name for name, _ in named[::2]], exponent


def _learns_all(layer: nn.Linear) -> bool:
    """Whether a layer has biases, and nothing of it is frozen."""
    return layer.bias is not None and all(parameter.requires_grad for parameter in layer.parameters())


def _array(tensor: Tensor, dtype: torch.dtype) -> np.ndarray:
    """The tensor's own memory."""
    if tensor.device.type != "cpu" or tensor.dtype is not dtype or not tensor.is_contiguous():
        raise CompilationError(f"only {dtype} on the CPU is, in one piece")
    return tensor.numpy()
