"""Small actors and critics, without an environment."""

from dataclasses import replace

import torch
from tensordict import TensorDict
from torchrl.data import Bounded

from carrl.algorithms.actor_critic.actor_critic import ActorCriticAlgorithm
from carrl.algorithms.actor_critic.exploration import NoNoise
from carrl.algorithms.actor_critic.loss import DDPG, SAC, TD3
from carrl.algorithms.actor_critic.network import make_actor_critic
from carrl.algorithms.actor_critic.update import Replicate
from carrl.algorithms.common.optimizer import make_soft_update

GAMMA = 0.5
RULES = {
    "ddpg": DDPG(GAMMA, 0.1, saturation=0.02),
    "td3": TD3(GAMMA, 0.2, policy_delay=2, policy_noise=0.2, noise_clip=0.5),
    "sac": SAC(GAMMA, 0.2, alpha=1e-3, learn_alpha=False, target_entropy=None, alpha_rate=1.0),
}


def action_spec(controls=1):
    return Bounded(-1.0, 1.0, shape=(controls,), dtype=torch.float32)


def make_networks(rule, observation_size, controls=1, sizes=(32, 32), seed=1):
    return make_actor_critic(
        list(sizes),
        list(sizes),
        "relu",
        observation_size=observation_size,
        controls=controls,
        is_stochastic=rule.is_stochastic,
        critics=rule.critics,
        generator=torch.Generator().manual_seed(seed),
    )


def make_replicate(rule, observation_size, controls=1, seed=1, lr=0.01, tau=0.1, **changes):
    networks = make_networks(rule, observation_size, controls, seed=seed)
    loss = rule.make(networks, controls)
    updater = make_soft_update(tau, loss=loss)
    optimizers = {
        part: torch.optim.Adam(rule.parameters(loss, part), lr=lr * rate) for part, rate in rule.rates.items()
    }
    made = Replicate(seed, rule, networks.actor, loss, optimizers, updater, torch.Generator().manual_seed(seed))
    return replace(made, **changes)


def make_algorithm(rule, observation_size, controls=1, seeds=(1,), **options):
    replicates = [make_replicate(rule, observation_size, controls, seed=seed, **options) for seed in seeds]
    noise = NoNoise(action_spec=action_spec(controls), generators=[torch.Generator() for _ in seeds])
    return ActorCriticAlgorithm(replicates, noise, [f"control_{number}" for number in range(controls)])


def random_batch(transitions=16, observation_size=3, controls=2, seed=0):
    """Transitions [N] of nowhere in particular, every fourth of which ends."""
    generator = torch.Generator().manual_seed(seed)
    ends = (torch.arange(transitions) % 4 == 0)[:, None]
    following = {
        "observation": torch.randn(transitions, observation_size, generator=generator),
        "reward": torch.randn(transitions, 1, generator=generator),
        "done": ends,
        "terminated": ends,
    }
    return TensorDict(
        {
            "observation": torch.randn(transitions, observation_size, generator=generator),
            "action": 2 * torch.rand(transitions, controls, generator=generator) - 1,
            "next": following,
        },
        [transitions],
    )
