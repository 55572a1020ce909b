"""From configuration to objects: the only code that sees the config, wiring the parts in data-flow order."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torchrl.collectors import Collector
from torchrl.data import Categorical, TensorDictReplayBuffer, TensorSpec
from torchrl.modules import QValueActor

from carrl.algorithms.common.policy import GreedyPolicy
from carrl.algorithms.common.weight_noise import WeightNoise, is_noisy
from carrl.algorithms.dqn.exploration import EpsilonGreedy
from carrl.algorithms.dqn.exploring_policy import ExploringPolicy
from carrl.config import build_node, build_terms
from carrl.data.cluster_collector import ClusterCollector, WorkerParts
from carrl.data.logs import check_logs, fill_from_logs
from carrl.data.returns import NStepReturns
from carrl.env.track_env import TrackEnv
from carrl.errors import ConfigError, shown
from carrl.task.observation import Observation
from carrl.task.reward import Reward
from carrl.task.task import World
from carrl.tracks.circuits import Circuits
from carrl.tracks.track import Track
from carrl.train.combinations import check_offline, check_priorities
from carrl.train.learner import Agent, Learner
from carrl.train.plan import EvaluationPlan, OfflinePlan, TrainingPlan


@dataclass(frozen=True)
class Learning:
    """What learns, wherever its transitions come from; `agents` train side by side, each as it would alone."""

    world: World
    agents: list[Agent]
    policy: GreedyPolicy
    replay_buffer: TensorDictReplayBuffer
    learner: Learner
    plan: TrainingPlan


@dataclass(frozen=True)
class Pipeline(Learning):
    """The parts of a training run in the simulator, built and wired."""

    env: TrackEnv
    exploration: EpsilonGreedy
    collector: Collector | ClusterCollector
    evaluation: EvaluationPlan
    returns: NStepReturns | None


@dataclass(frozen=True)
class OfflinePipeline(Learning):
    """The parts of a training run on logs, built and wired: there is no simulator among them."""

    offline_plan: OfflinePlan


Config = Mapping[str, Any]

CLUSTER_COLLECTOR = "carrl.data.cluster_collector.ClusterCollector"


def build_pipeline(config: Config) -> Pipeline:
    """Builds a training run in the simulator from its resolved configuration, as plain Python values.

    Raises:
        CarrlError: a part refuses its values.
    """
    learning = _build_learning(config, config["replay_buffer"])
    seeds = [agent.seed for agent in learning.agents]
    env = _build_env(config, learning.world, seeds, config["device"])
    exploration = _build_exploration(config, env.action_spec_unbatched, seeds).to(config["device"])
    return Pipeline(
        **vars(learning),
        env=env,
        exploration=exploration,
        collector=_build_collector(config, env, learning, ExploringPolicy(learning.policy, exploration)),
        evaluation=build_node("evaluation", config["evaluation"]),
        returns=_build_optional(config, "returns", gamma=config["loss"]["gamma"]),
    )


def _build_env(config: Config, world: World, seeds: list[int], device: str, **changes: Any) -> TrackEnv:
    env: TrackEnv = build_node(
        "env",
        {**config["env"], **changes},
        track=world.circuits.training,
        vehicle=world.vehicle,
        sensor=world.sensor,
        action=world.action,
        observation=world.observation,
        reward=world.reward,
        start=build_node("start", config["start"]),
        device=device,
        seed=[_part_seed(seed, "env") for seed in seeds],
    )
    return env


def _build_exploration(config: Config, action_spec: TensorSpec, seeds: list[int]) -> EpsilonGreedy:
    exploration: EpsilonGreedy = build_node(
        "exploration",
        config["exploration"],
        action_spec=action_spec,
        generators=[_generator(seed, "exploration") for seed in seeds],
    )
    return exploration


def _build_collector(
    config: Config, env: TrackEnv, learning: Learning, policy: ExploringPolicy
) -> Collector | ClusterCollector:
    node = config["collector"]
    if not isinstance(node, Mapping) or node.get("_target_") != CLUSTER_COLLECTOR:
        return build_node("collector", node, env=env, policy=policy)
    if len(learning.agents) != 1:
        raise ConfigError("collector=ray trains one agent; leave trainer.seeds out, or set collector=sync")
    if config.get("returns"):
        raise ConfigError(
            "collector=ray may break an episode off, which returns over several steps would join to the next; "
            "set returns=one_step, or collector=sync"
        )
    parts = WorkerParts(
        make_env=partial(_build_workers_env, config, learning.world),
        make_policy=partial(_build_workers_policy, config, env.action_spec_unbatched.to("cpu")),
    )
    seed = learning.agents[0].seed
    return build_node("collector", node, cars=env.batch_size[0], seed=seed, parts=parts, policy=policy)


def _build_workers_env(config: Config, world: World, cars: int, seed: int) -> TrackEnv:
    return _build_env(config, world, [seed], "cpu", num_envs=cars)


def _build_workers_policy(config: Config, action_spec: TensorSpec, seed: int) -> ExploringPolicy:
    greedy = GreedyPolicy([build_network(config, build_world(config))])
    return ExploringPolicy(greedy, _build_exploration(config, action_spec, [seed]))


def learns_from_logs(config: Config) -> bool:
    """Whether a run's transitions come from logs instead of the simulator."""
    return bool(config.get("data"))


def logs_of(config: Config) -> list[Path]:
    """The logs that a run learns from; none in the simulator."""
    if not learns_from_logs(config):
        return []
    plan: OfflinePlan = build_node("data", config["data"])
    return plan.paths


def build_offline_pipeline(config: Config) -> OfflinePipeline:
    """Builds a training run on logs, with all their transitions in the replay buffer of every agent.

    Raises:
        CarrlError: a part refuses its values, or a log cannot be read or does not fit the configuration.
    """
    check_offline(config)
    offline_plan: OfflinePlan = build_node("data", config["data"])
    transitions = check_logs(offline_plan.paths, build_world(config))
    learning = _build_learning(config, _with_room(config["replay_buffer"], transitions))
    fill_from_logs(learning.replay_buffer, offline_plan.paths, len(learning.agents), learning.world.action)
    return OfflinePipeline(**vars(learning), offline_plan=offline_plan)


def _with_room(node: Config, transitions: int) -> Config:
    """The replay buffer's node with the least multiple of its capacity that holds so many transitions.

    A multiple, since compiled updates are made for one capacity: most logs share it with each other and with runs in
    the simulator.

    Raises:
        ConfigError: the node's values are refused, or there are too few transitions for a minibatch.
    """
    buffer: TensorDictReplayBuffer = build_node("replay_buffer", node, device="cpu", generators=[])
    if transitions < buffer.batch_size:
        raise ConfigError(
            f"data.path has {transitions} transitions, fewer than the {buffer.batch_size} of one minibatch; "
            "name more logs, or set a smaller replay_buffer.batch_size"
        )
    return {**node, "capacity": node["capacity"] * -(-transitions // node["capacity"])}


def _build_learning(config: Config, replay_buffer_node: Config) -> Learning:
    device = _checked_device(config["device"])
    compiled = _checked_flag("compile", config["compile"])
    plan: TrainingPlan = build_node("trainer", config["trainer"])
    seeds = plan.agent_seeds(config["seed"])
    world = build_world(config)
    frames_per_update = 1 if learns_from_logs(config) else plan.frames_per_update
    agents = [_build_agent(config, world, seed, device) for seed in seeds]
    replay_buffer = build_node(
        "replay_buffer",
        replay_buffer_node,
        device=device,
        generators=[_generator(seed, "replay_buffer") for seed in seeds],
    )
    check_priorities(agents[0].loss, replay_buffer)
    return Learning(
        world=world,
        agents=agents,
        policy=GreedyPolicy([agent.network for agent in agents]),
        replay_buffer=replay_buffer,
        learner=Learner(agents, replay_buffer, compiled=compiled, frames_per_update=frames_per_update),
        plan=plan,
    )


def _build_agent(config: Config, world: World, seed: int, device: torch.device) -> Agent:
    network = build_network(config, world, _generator(seed, "network")).to(device)
    loss = build_node("loss", config["loss"], network=network)
    target_updater = build_node("target_updater", config["target_updater"], loss=loss)
    return Agent(
        seed=seed,
        network=network,
        loss=loss,
        optimizer=build_node("optimizer", config["optimizer"], params=list(loss.parameters())),
        target_updater=target_updater,
        clipping=_build_optional(config, "gradient_clipping"),
        learning_rate=_build_optional(config, "learning_rate"),
        noise=WeightNoise(network, loss, _generator(seed, "noise")) if is_noisy(network) else None,
    )


def _build_optional(config: Config, name: str, **dependencies: Any) -> Any:
    """A part that may be absent, as it is in runs of earlier versions."""
    return build_node(name, config[name], **dependencies) if config.get(name) else None


def build_world(config: Config) -> World:
    """Builds the track, car, sensors, observation and reward that a run was, or will be, trained with."""
    track: Track | Circuits = build_node("track", config["track"])
    return World(
        circuits=track if isinstance(track, Circuits) else Circuits.only(track),
        vehicle=build_node("vehicle", config["vehicle"]),
        sensor=build_node("sensor", config["sensor"]),
        action=build_node("action", config["action"]),
        observation=Observation(build_terms("observation", config["observation"])),
        reward=Reward(build_terms("reward", config["reward"])),
    )


def build_network(config: Config, world: World, generator: torch.Generator | None = None) -> QValueActor:
    """Builds the network for this world, with the weights that the generator draws.

    Raises:
        ConfigError: the actions of the world are not a choice among some.
    """
    spec = world.action.spec
    if not isinstance(spec, Categorical):
        raise ConfigError("the network has a value for each action; set an action of discrete choices, such as steer3")
    return build_node(
        "network",
        config["network"],
        observation_size=world.observation_size,
        action_count=spec.n,
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
        raise ConfigError(f"{name} is {shown(value)}; it must be true or false")
    return value


_RANDOM_PARTS = ("env", "network", "exploration", "replay_buffer", "noise")  # each one's seed depends on its place


def _generator(seed: int, part: str) -> torch.Generator:
    """A generator for one part, so that what one part draws never shifts what another draws."""
    return torch.Generator().manual_seed(_part_seed(seed, part))


def _part_seed(seed: int, part: str) -> int:
    states = np.random.SeedSequence(seed).generate_state(len(_RANDOM_PARTS))
    return int(states[_RANDOM_PARTS.index(part)])
