"""What actors and critics learn from: TorchRL's losses of DDPG, TD3 and SAC, and what sets the three apart.

Shapes: `N` transitions, `C` controls.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor
from torchrl.modules import ProbabilisticActor, TanhNormal
from torchrl.objectives import DDPGLoss, LossModule, SACLoss, TD3Loss

from carrl.algorithms.actor_critic.network import Actor, ActorCritic, Critic
from carrl.errors import ConfigError

ACTOR, CRITIC, ALPHA = "actor", "critic", "alpha"
"""The parts of a replicate that are trained, each with an optimizer of its own; alpha is SAC's temperature."""


_LEAST = 1e-6
"""That the logarithm of nothing is not taken."""


class Losses(NamedTuple):
    """What a loss found.

    Attributes:
        of_parts: [] each, by the part that it trains.
        td_error: squared, of the critic that is farther off, [N].
        figures: what else there is to say, [] each.
    """

    of_parts: Mapping[str, Tensor]
    td_error: Tensor
    figures: Mapping[str, Tensor]


@dataclass(frozen=True)
class ActorCriticLoss(ABC):
    """A rule by which actors and critics learn.

    Attributes:
        gamma: discount factor.
        actor_rate: the actor's learning rate, as a multiple of optimizer.lr.
        is_stochastic: whether the actor draws its actions.
        critics: how many there are.
        critic_name: what TorchRL's loss calls them.
        has_target_actor: whether an actor of its own picks what follows.
        draws: how often normal numbers are drawn in an update, [N, C] each.
    """

    gamma: float
    actor_rate: float
    is_stochastic: ClassVar[bool] = False
    critics: ClassVar[int] = 2
    critic_name: ClassVar[str] = "qvalue_network"
    has_target_actor: ClassVar[bool] = True
    draws: ClassVar[int] = 0

    def __post_init__(self) -> None:
        """Raises ConfigError unless the discount lies in 0..1 and the rate is positive."""
        if not 0 <= self.gamma <= 1:
            raise ConfigError(f"loss.gamma is {self.gamma}; it must lie in 0..1")
        _check_rate("actor_rate", self.actor_rate)

    @property
    def rates(self) -> Mapping[str, float]:
        """The parts that are trained, each with its learning rate as a multiple of optimizer.lr."""
        return {CRITIC: 1.0, ACTOR: self.actor_rate}

    @property
    def update_kinds(self) -> int:
        """Of so many updates one, the first, moves the actor and the targets, too; 1 for all alike."""
        return 1

    def make(self, networks: ActorCritic, controls: int) -> LossModule:
        """TorchRL's loss of these networks, with targets of its own: actions have so many numbers."""
        loss = self._make(networks, controls)
        loss.make_value_estimator(gamma=self.gamma)
        return loss

    def parameters(self, loss: LossModule, part: str) -> list[Tensor]:
        """What is trained of a part."""
        if part == ALPHA:
            return [loss.log_alpha]
        network = "actor_network" if part == ACTOR else self.critic_name
        return list(loss._modules[f"{network}_params"].parameters())

    @abstractmethod
    def _make(self, networks: ActorCritic, controls: int) -> LossModule:
        """It, without a discount yet."""

    @abstractmethod
    def losses(self, loss: LossModule, transitions: TensorDictBase, with_actor: bool) -> Losses:
        """Calls the loss on transitions [N]; of the critics alone, or of all parts."""


@dataclass(frozen=True)
class DDPG(ActorCriticLoss):
    """The actor climbs one critic; targets of both follow them.

    Source: Lillicrap et al. 2016, "Continuous control with deep reinforcement learning", Algorithm 1.

    Attributes:
        gamma: discount factor.
        actor_rate: the actor's learning rate, as a multiple of optimizer.lr.
        saturation: what actions near -1 and 1 cost the actor, times -log(1 - action^2): where tanh is flat nothing else
            brings an action back.
    """

    saturation: float
    critics = 1
    critic_name = "value_network"

    def __post_init__(self) -> None:
        """Raises ConfigError for a price that is negative."""
        super().__post_init__()
        if not 0 <= self.saturation < math.inf:
            raise ConfigError(f"loss.saturation is {self.saturation}; it must be a number of at least 0")

    def _make(self, networks: ActorCritic, controls: int) -> LossModule:
        # By default TorchRL 0.14's targets come from the actor that is trained.
        return DDPGLoss(_acting(networks.actor), _valuing(networks.critics[0]), loss_function="l2", delay_actor=True)

    def losses(self, loss: LossModule, transitions: TensorDictBase, with_actor: bool) -> Losses:
        """Both."""
        found = loss(transitions)
        of_actor = found["loss_actor"]
        if self.saturation:
            with loss.actor_network_params.to_module(loss.actor_network):
                action = loss.actor_network.module(transitions["observation"])
            of_actor = of_actor - self.saturation * (1 - action.square() + _LEAST).log().mean()
        return Losses({CRITIC: found["loss_value"], ACTOR: of_actor}, transitions["td_error"].detach(), {})


@dataclass(frozen=True)
class TD3(ActorCriticLoss):
    """The less hopeful of two critics counts, on an action that noise has blurred; the actor moves less often.

    Source: Fujimoto et al. 2018, "Addressing Function Approximation Error in Actor-Critic Methods", Algorithm 1.

    Attributes:
        gamma: discount factor.
        actor_rate: the actor's learning rate, as a multiple of optimizer.lr.
        policy_delay: updates of the critics for one of the actor and all targets.
        policy_noise: standard deviation of the noise on the targets' actions, which reach from -1 to 1.
        noise_clip: where that noise is cut off.
    """

    policy_delay: int
    policy_noise: float
    noise_clip: float
    draws = 1

    def __post_init__(self) -> None:
        """Raises ConfigError for a delay of less than 1, and for noise that is negative."""
        super().__post_init__()
        if self.policy_delay < 1:
            raise ConfigError(f"loss.policy_delay is {self.policy_delay}; it must be at least 1")
        for name in ("policy_noise", "noise_clip"):
            if not 0 <= getattr(self, name) < math.inf:
                raise ConfigError(f"loss.{name} is {getattr(self, name)}; it must be a number of at least 0")

    @property
    def update_kinds(self) -> int:
        """One of `policy_delay`."""
        return self.policy_delay

    def _make(self, networks: ActorCritic, controls: int) -> LossModule:
        return TD3Loss(
            _acting(networks.actor),
            [_valuing(critic) for critic in networks.critics],
            bounds=(-1.0, 1.0),  # in whose units the noise is
            num_qvalue_nets=self.critics,
            policy_noise=self.policy_noise,
            noise_clip=self.noise_clip,
            loss_function="l2",  # the paper's; by default TorchRL has smooth_l1
        )

    def losses(self, loss: LossModule, transitions: TensorDictBase, with_actor: bool) -> Losses:
        """The critics', and the actor's in its turn."""
        of_critics, found = loss.value_loss(transitions)
        parts = {CRITIC: of_critics}
        if with_actor:
            parts[ACTOR], _ = loss.actor_loss(transitions)
        return Losses(parts, found["td_error"].detach().amax(0), {})


@dataclass(frozen=True)
class SAC(ActorCriticLoss):
    """The actor is to be as random as it can afford to be; the less hopeful of two critics counts.

    Source: Haarnoja et al. 2018, "Soft Actor-Critic Algorithms and Applications", Algorithm 1.

    Attributes:
        gamma: discount factor.
        actor_rate: the actor's learning rate, as a multiple of optimizer.lr.
        alpha: the temperature, what a nat of entropy is worth in reward; where it is learnt, the first one.
        learn_alpha: whether it is learnt, so that the entropy is about `target_entropy`.
        target_entropy: of the actions, nats; None for minus the number of controls.
        alpha_rate: the temperature's learning rate, as a multiple of optimizer.lr.
    """

    alpha: float
    learn_alpha: bool
    target_entropy: float | None
    alpha_rate: float
    is_stochastic = True
    has_target_actor = False
    draws = 2

    def __post_init__(self) -> None:
        """Raises ConfigError for a temperature that is not positive, or what only matters to one that is learnt."""
        super().__post_init__()
        _check_rate("alpha", self.alpha)
        _check_rate("alpha_rate", self.alpha_rate)
        for name, default in (("target_entropy", None), ("alpha_rate", 1.0)):
            if not self.learn_alpha and getattr(self, name) != default:
                raise ConfigError(
                    f"loss.{name} is {getattr(self, name)}, but with loss.learn_alpha=false the temperature stays "
                    "as it is; set loss.learn_alpha=true"
                )

    @property
    def rates(self) -> Mapping[str, float]:
        """Those of all, and the temperature's where it is learnt."""
        return {**super().rates, **({ALPHA: self.alpha_rate} if self.learn_alpha else {})}

    def _make(self, networks: ActorCritic, controls: int) -> LossModule:
        # A number, since TorchRL 0.14 counts the cars of a batched action spec as controls.
        entropy = -float(controls) if self.target_entropy is None else self.target_entropy
        loss = SACLoss(
            _drawing(networks.actor),
            [_valuing(critic) for critic in networks.critics],
            num_qvalue_nets=self.critics,
            loss_function="l2",  # the paper's; by default TorchRL has smooth_l1
            alpha_init=self.alpha,
            fixed_alpha=not self.learn_alpha,
            target_entropy=entropy,
        )
        assert loss.target_entropy == entropy  # looked up once: it becomes a buffer, which must be there before tracing
        return loss

    def losses(self, loss: LossModule, transitions: TensorDictBase, with_actor: bool) -> Losses:
        """All of them."""
        found = loss(transitions)
        parts = {CRITIC: found["loss_qvalue"], ACTOR: found["loss_actor"]}
        if self.learn_alpha:
            parts[ALPHA] = found["loss_alpha"]
        figures = {"entropy": found["entropy"], "alpha": found["alpha"]}
        return Losses(parts, transitions["td_error"].detach().square(), figures)


def values(loss: LossModule, critic_name: str, observation: Tensor, action: Tensor) -> Tensor:
    """What the least hopeful critic of a loss expects of actions [N, C], [N]."""
    network, parameters = getattr(loss, critic_name), getattr(loss, f"{critic_name}_params")
    found = []
    with torch.no_grad():
        for own in parameters.unbind(0) if parameters.batch_dims else [parameters]:
            with own.to_module(network, preserve_module_state=False):
                found.append(network.module(observation, action)[:, 0])
    return torch.stack(found).amin(0)


def _acting(actor: Actor) -> TensorDictModule:
    return TensorDictModule(actor, in_keys=["observation"], out_keys=["action"])


def _drawing(actor: Actor) -> ProbabilisticActor:
    moments = TensorDictModule(actor, in_keys=["observation"], out_keys=["loc", "scale"])
    return ProbabilisticActor(
        moments,
        in_keys=["loc", "scale"],
        out_keys=["action"],
        distribution_class=TanhNormal,
        return_log_prob=True,
    )


def _valuing(critic: Critic) -> TensorDictModule:
    return TensorDictModule(critic, in_keys=["observation", "action"], out_keys=["state_action_value"])


def _check_rate(name: str, value: float) -> None:
    if not 0 < value < math.inf:
        raise ConfigError(f"loss.{name} is {value}; it must be a positive number")
