"""From configuration to objects: the only code that sees the config, wiring the parts in data-flow order."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from tensordict.nn import TensorDictSequential
from torchrl.collectors import Collector
from torchrl.data import TensorDictReplayBuffer
from torchrl.modules import QValueActor

from carrl.agent.exploration import ExponentialEpsilonGreedy
from carrl.agent.policy import GreedyPolicy
from carrl.config import build_node
from carrl.env.observation import observation_size
from carrl.env.reward import Reward
from carrl.env.track_env import TrackEnv
from carrl.errors import ConfigError
from carrl.run.learner import Agent, Learner
from carrl.run.plan import EvaluationPlan, TrainingPlan
from carrl.sim.sensor import Sensor
from carrl.sim.track import Track
from carrl.sim.vehicle import Action, VehicleModel


@dataclass(frozen=True)
class World:
    """What is simulated: everything that an evaluation needs but the policy."""

    track: Track
    vehicle: VehicleModel
    sensor: Sensor
    reward: Reward


@dataclass(frozen=True)
class Pipeline:
    """The parts of a training run, built and wired; `agents` train side by side, each as it would alone."""

    world: World
    env: TrackEnv
    agents: list[Agent]
    policy: GreedyPolicy
    exploration: ExponentialEpsilonGreedy
    collector: Collector
    replay_buffer: TensorDictReplayBuffer
    learner: Learner
    plan: TrainingPlan
    evaluation: EvaluationPlan


Config = Mapping[str, Any]


def build_pipeline(config: Config) -> Pipeline:
    """Builds a training run from its resolved configuration, as plain Python values.

    Raises:
        CarrlError: a part refuses its values.
    """
    device = _checked_device(config["device"])
    compiled = _checked_flag("compile", config["compile"])
    plan: TrainingPlan = build_node("trainer", config["trainer"])
    seeds = plan.agent_seeds(config["seed"])
    world = build_world(config)
    env = build_node(
        "env",
        config["env"],
        track=world.track,
        vehicle=world.vehicle,
        sensor=world.sensor,
        reward=world.reward,
        device=device,
        seed=[_part_seed(seed, "env") for seed in seeds],
    )
    agents = [_build_agent(config, seed, device) for seed in seeds]
    policy = GreedyPolicy([agent.network for agent in agents], observes_action(config))
    exploration = build_node(
        "exploration",
        config["exploration"],
        action_spec=env.action_spec_unbatched,
        generators=[_generator(seed, "exploration") for seed in seeds],
    ).to(device)
    collector = build_node("collector", config["collector"], env=env, policy=TensorDictSequential(policy, exploration))
    replay_buffer = build_node(
        "replay_buffer",
        config["replay_buffer"],
        device=device,
        generators=[_generator(seed, "replay_buffer") for seed in seeds],
    )
    return Pipeline(
        world=world,
        env=env,
        agents=agents,
        policy=policy,
        exploration=exploration,
        collector=collector,
        replay_buffer=replay_buffer,
        learner=Learner(agents, replay_buffer, compiled=compiled),
        plan=plan,
        evaluation=build_node("evaluation", config["evaluation"]),
    )


def _build_agent(config: Config, seed: int, device: torch.device) -> Agent:
    network = build_network(config, _generator(seed, "network")).to(device)
    loss = build_node("loss", config["loss"], network=network)
    return Agent(
        seed=seed,
        network=network,
        loss=loss,
        optimizer=build_node("optimizer", config["optimizer"], params=list(loss.parameters())),
        target_updater=build_node("target_updater", config["target_updater"], loss=loss),
    )


def build_world(config: Config) -> World:
    """Builds the track, car, sensors and reward that a run was, or will be, trained with."""
    return World(
        track=build_node("track", config["track"]),
        vehicle=build_node("vehicle", config["vehicle"]),
        sensor=build_node("sensor", config["sensor"]),
        reward=build_node("reward", config["reward"]),
    )


def build_network(config: Config, generator: torch.Generator | None = None) -> QValueActor:
    """Builds the network with the weights that the generator draws."""
    return build_node(
        "network",
        config["network"],
        observation_size=observation_size(config["sensor"]["rays"], observes_action(config)),
        action_count=len(Action),
        generator=generator or torch.Generator(),
    )


def observes_action(config: Config) -> bool:
    """Whether the network reads the last action, too."""
    return _checked_flag("env.observe_action", config["env"]["observe_action"])


def _checked_device(name: str) -> torch.device:
    """The device of this name.

    Raises:
        ConfigError: torch has no such device here.
    """
    try:
        device = torch.device(name)
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError) as error:
        raise ConfigError(f"device is '{name}', which torch cannot use here; set device=cpu") from error
    return device


def _checked_flag(name: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise ConfigError(f"{name} is {value!r}; it must be true or false")
    return value


_RANDOM_PARTS = ("env", "network", "exploration", "replay_buffer")


def _generator(seed: int, part: str) -> torch.Generator:
    """A generator for one part, so that what one part draws never shifts what another draws."""
    return torch.Generator().manual_seed(_part_seed(seed, part))


def _part_seed(seed: int, part: str) -> int:
    states = np.random.SeedSequence(seed).generate_state(len(_RANDOM_PARTS))
    return int(states[_RANDOM_PARTS.index(part)])
