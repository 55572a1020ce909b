"""From configuration to objects: the only code that sees the config, wiring the parts in data-flow order."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
from tensordict.nn import TensorDictSequential
from torchrl.collectors import Collector
from torchrl.data import TensorDictReplayBuffer
from torchrl.modules import QValueActor
from torchrl.objectives import DQNLoss, HardUpdate

from carrl.agent.exploration import ExponentialEpsilonGreedy
from carrl.config import build_node
from carrl.env.reward import Reward
from carrl.env.track_env import TrackEnv
from carrl.errors import ConfigError
from carrl.run.learner import Learner
from carrl.run.plan import EvaluationPlan, Limits
from carrl.sim.sensor import Sensor
from carrl.sim.track import Track
from carrl.sim.vehicle import Action, Vehicle


@dataclass(frozen=True)
class World:
    """What is simulated: everything that an evaluation needs but the policy."""

    track: Track
    vehicle: Vehicle
    sensor: Sensor
    reward: Reward


@dataclass(frozen=True)
class Pipeline:
    """The parts of a training run, built and wired."""

    world: World
    env: TrackEnv
    network: QValueActor
    exploration: ExponentialEpsilonGreedy
    collector: Collector
    replay_buffer: TensorDictReplayBuffer
    loss: DQNLoss
    target_updater: HardUpdate
    learner: Learner
    limits: Limits
    evaluation: EvaluationPlan


Config = Mapping[str, Any]


def build_pipeline(config: Config) -> Pipeline:
    """Builds a training run from its resolved configuration, as plain Python values.

    Raises:
        CarrlError: a part refuses its values.
    """
    device = _checked_device(config["device"])
    generator = partial(_generator, config["seed"])
    world = build_world(config)
    env = build_node(
        "env",
        config["env"],
        track=world.track,
        vehicle=world.vehicle,
        sensor=world.sensor,
        reward=world.reward,
        device=device,
        seed=generator("env").initial_seed(),
    )
    network = build_network(config, generator("network")).to(device)
    exploration = build_node(
        "exploration",
        config["exploration"],
        action_spec=env.action_spec_unbatched,
        generator=generator("exploration", device),
    ).to(device)
    policy = TensorDictSequential(network, exploration)
    collector = build_node("collector", config["collector"], env=env, policy=policy)
    replay_buffer = build_node(
        "replay_buffer", config["replay_buffer"], device=device, generator=generator("replay_buffer")
    )
    loss = build_node("loss", config["loss"], network=network)
    optimizer = build_node("optimizer", config["optimizer"], params=list(loss.parameters()))
    return Pipeline(
        world=world,
        env=env,
        network=network,
        exploration=exploration,
        collector=collector,
        replay_buffer=replay_buffer,
        loss=loss,
        target_updater=build_node("target_updater", config["target_updater"], loss=loss),
        learner=Learner(loss, optimizer, replay_buffer, compiled=_checked_flag("compile", config["compile"])),
        limits=build_node("trainer", config["trainer"]),
        evaluation=build_node("evaluation", config["evaluation"]),
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
        observation_size=config["sensor"]["rays"],
        action_count=len(Action),
        generator=generator or torch.Generator(),
    )


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


def _generator(seed: int, part: str, device: torch.device | str = "cpu") -> torch.Generator:
    """A generator for one part, so that what one part draws never shifts what another draws."""
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise ConfigError(f"seed is {seed!r}; it must be a whole number of at least 0")
    states = np.random.SeedSequence(seed).generate_state(len(_RANDOM_PARTS))
    return torch.Generator(device).manual_seed(int(states[_RANDOM_PARTS.index(part)]))
