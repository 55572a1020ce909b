"""From configuration to objects: the only code that sees the config, wiring the parts in data-flow order."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import nn
from torchrl.data import TensorDictReplayBuffer

from carrl.algorithms.algorithm import Algorithm, CollectPolicy, Policy, Recipe
from carrl.config import as_mapping, build_node, build_terms
from carrl.data.collector import Collector, WorkerParts
from carrl.data.logs import check_logs, fill_from_logs
from carrl.data.source import Logged, Simulated, Source
from carrl.env.track_env import TrackEnv
from carrl.errors import CheckpointError, ConfigError
from carrl.sim.vehicle import VehicleModel
from carrl.task.action import fitted
from carrl.task.end import End
from carrl.task.observation import Observation
from carrl.task.random_streams import part_generator, part_seed
from carrl.task.reward import Reward
from carrl.task.task import World
from carrl.task.trial import try_terms
from carrl.tracks.circuits import Circuits
from carrl.tracks.track import Track
from carrl.train.checkpoint import load_checkpoint
from carrl.train.files import CONFIG, checkpoint_path
from carrl.train.learner import Learner
from carrl.train.plan import EvaluationPlan, Limits, OfflinePlan, TrainingPlan, checked_flag, no_such_device

Config = Mapping[str, Any]
DEFAULT_ALGORITHM = {"_target_": "carrl.algorithms.dqn.dqn.DQNRecipe"}
"""Of runs from before there was a choice."""
ANY_TRACK = {"_target_": "carrl.tracks.track.Track.load", "name_or_path": "oval"}
"""A policy does not depend on where it learnt, which may be a file that is elsewhere now, or hundreds of circuits."""


@dataclass(frozen=True)
class Pipeline:
    """The parts of a training run, built and wired, wherever its transitions come from.

    Attributes:
        world: that is driven in.
        algorithm: whose replicates train side by side, each as it would alone.
        replay_buffer: with the memories of all replicates.
        source: what fills it.
        learner: what makes the updates.
        plan: when a state is kept, and by which seeds is trained.
        limits: when a run is over.
        evaluation: when and from where networks are tried out; None for the start line, at the end alone.
    """

    world: World
    algorithm: Algorithm
    replay_buffer: TensorDictReplayBuffer
    source: Source
    learner: Learner
    plan: TrainingPlan
    limits: Limits
    evaluation: EvaluationPlan | None


def build_pipeline(config: Config) -> Pipeline:
    """Builds a training run from its resolved configuration, as plain Python values.

    A run on logs has all their transitions in the replay buffer of every replicate.

    Raises:
        CarrlError: a part refuses its values, or a log cannot be read or does not fit the configuration.
    """
    device = _checked_device(config["device"])
    compiled = checked_flag("compile", config["compile"])
    offline: OfflinePlan | None = build_node("data", config["data"]) if learns_from_logs(config) else None
    if offline and _has_n_step_returns(config):
        raise ConfigError(
            "returns are over several steps, which a log may not have in full, and data is log; set returns.steps=1"
        )
    plan: TrainingPlan = build_node("trainer", config["trainer"])
    seeds = plan.replicate_seeds(config["seed"])
    world = build_world(config)
    buffer_node = config["replay_buffer"]
    if offline:
        buffer_node = _with_room(buffer_node, check_logs(offline.paths, world))
    algorithm = _recipe(config).build(config, world, seeds, device)
    buffer = _build_buffer(buffer_node, device, seeds)
    algorithm.check_memory(buffer.sampler.is_weighted)
    evaluation: EvaluationPlan | None = None
    source: Source
    if offline:
        fill_from_logs(buffer, offline.paths, len(seeds), world.action)
        source, limits = Logged(buffer, offline.updates), Limits(updates=offline.updates)
    else:
        source, limits = _build_simulated(config, world, algorithm, buffer), Limits(plan.frames, plan.episodes)
        evaluation = build_node("evaluation", config["evaluation"])
    frames_per_update = 1 if offline else plan.frames_per_update
    learner = Learner(algorithm, buffer, compiled=compiled, frames_per_update=frames_per_update)
    return Pipeline(world, algorithm, buffer, source, learner, plan, limits, evaluation)


def _recipe(config: Config) -> Recipe:
    recipe: Recipe = build_node("algorithm", config.get("algorithm") or DEFAULT_ALGORITHM)
    return recipe


def _build_buffer(node: Config, device: torch.device | str, seeds: list[int]) -> TensorDictReplayBuffer:
    buffer: TensorDictReplayBuffer = build_node(
        "replay_buffer", node, device=device, generators=[part_generator(seed, "replay_buffer") for seed in seeds]
    )
    return buffer


def _with_room(node: Config, transitions: int) -> Config:
    """The replay buffer's node with the least multiple of its capacity that holds so many transitions.

    A multiple, since compiled updates are made for one capacity: most logs share it with each other and with runs in
    the simulator.

    Raises:
        ConfigError: the node's values are refused, or there are too few transitions for a minibatch.
    """
    buffer = _build_buffer(node, "cpu", [])
    if transitions < buffer.batch_size:
        raise ConfigError(
            f"data.path has {transitions} transitions, fewer than the {buffer.batch_size} of one minibatch; "
            "name more logs, or set a smaller replay_buffer.batch_size"
        )
    return {**node, "capacity": node["capacity"] * -(-transitions // node["capacity"])}


def _build_simulated(config: Config, world: World, algorithm: Algorithm, buffer: TensorDictReplayBuffer) -> Simulated:
    env = _build_env(config, world, list(algorithm.seeds), config["device"])
    parts = WorkerParts(partial(_build_workers_env, config, world), partial(_build_workers_policy, config))
    collector: Collector = build_node(
        "collector",
        config["collector"],
        env=env,
        policy=algorithm.collect_policy,
        seeds=algorithm.seeds,
        parts=parts,
    )
    if not _has_n_step_returns(config):
        return Simulated(env, collector, buffer, None)
    if collector.may_break_off:
        raise ConfigError(
            "collector=ray may break an episode off, which returns over several steps would join to the next; "
            "set returns.steps=1, or collector=sync"
        )
    if "gamma" not in config["loss"]:
        raise ConfigError("returns over several steps need loss.gamma, which this loss lacks; set returns.steps=1")
    returns = build_node("returns", config["returns"], gamma=config["loss"]["gamma"])
    return Simulated(env, collector, buffer, returns)


def _has_n_step_returns(config: Config) -> bool:
    node = config.get("returns")
    return isinstance(node, Mapping) and node.get("steps") != 1


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
        end=_build_end(config),
        opponents=world.opponents,
        device=device,
        seed=[part_seed(seed, "env") for seed in seeds],
    )
    try_terms(env.task)
    return env


def _build_workers_env(config: Config, world: World, cars: int, seed: int) -> TrackEnv:
    return _build_env(config, world, [seed], "cpu", num_envs=cars)


def _build_workers_policy(config: Config, seed: int) -> CollectPolicy:
    return _recipe(config).build(config, build_world(config), [seed], torch.device("cpu")).collect_policy


def learns_from_logs(config: Config) -> bool:
    """Whether a run's transitions come from logs instead of the simulator."""
    return bool(config.get("data"))


def logs_of(config: Config) -> list[Path]:
    """The logs that a run learns from; none in the simulator."""
    if not learns_from_logs(config):
        return []
    plan: OfflinePlan = build_node("data", config["data"])
    return plan.paths


def build_world(config: Config) -> World:
    """Builds the track, car, sensors, observation and reward that a run was, or will be, trained with."""
    track: Track | Circuits = build_node("track", config["track"])
    vehicle: VehicleModel = build_node("vehicle", config["vehicle"])
    end = _build_end(config)
    return World(
        circuits=track if isinstance(track, Circuits) else Circuits.only(track),
        vehicle=vehicle,
        sensor=build_node("sensor", config["sensor"]),
        action=fitted(build_node("action", config["action"]), vehicle),
        observation=Observation(build_terms("observation", config["observation"])),
        reward=Reward(build_terms("reward", config["reward"])),
        opponents=build_node("opponents", config["opponents"]) if config.get("opponents") else None,
        cars_per_world=as_mapping("env", config["env"]).get("cars_per_world", 1),
        gap=build_node("start", config["start"]).gap,
        bump=end.bump if end else None,
    )


def load_driver(run: Path, config: Config) -> tuple[World, Policy]:
    """What a run's `best` network needs to drive: the world as it sees it, alone and on no track of its own; and it.

    Raises:
        CarrlError: the run is damaged.
    """
    world = build_world({**config, "track": ANY_TRACK, "opponents": None})
    return world, load_greedy_policy(run, "best", config, world)


def _build_end(config: Config) -> End | None:
    """None in a run from before there was a choice."""
    return End(build_terms("end", config["end"])) if "end" in config else None


def build_network(config: Config, world: World) -> nn.Module:
    """Builds the network that the run's checkpoints keep.

    Raises:
        ConfigError: the world has other actions than the algorithm can choose among.
    """
    return _recipe(config).make_network(config, world)


def load_network(run: Path, checkpoint: str, config: Config, world: World) -> nn.Module:
    """A run's `best` or `last` network.

    Raises:
        CheckpointError: the checkpoint is missing, damaged, or of another network than the configuration's.
    """
    return _load_network(run, checkpoint, config, world)[0]


def _load_network(run: Path, checkpoint: str, config: Config, world: World) -> tuple[nn.Module, int]:
    """The network, and after how many env steps it was saved; 0 where the checkpoint does not tell."""
    path = checkpoint_path(run, checkpoint)
    saved = load_checkpoint(path)
    state: Any = saved.get("network")
    frames: Any = saved.get("frames")
    network = build_network(config, world)
    if not _fits(state, network.state_dict()):
        raise CheckpointError(f"checkpoint '{path}' does not fit the network in {run / CONFIG}")
    network.load_state_dict(state)
    return network, frames if type(frames) is int else 0


class SavedPolicy(NamedTuple):
    """What a network does without exploration, and after how many env steps it was saved."""

    policy: Policy
    frames: int


def load_saved_policy(run: Path, checkpoint: str, config: Config, world: World) -> SavedPolicy:
    """The greedy policy of a run's `best` or `last` network, which another process may be writing anew.

    Raises:
        CheckpointError: as `load_network` does.
    """
    network, frames = _load_network(run, checkpoint, config, world)
    return SavedPolicy(greedy_policy(network, config), frames)


def load_greedy_policy(run: Path, checkpoint: str, config: Config, world: World) -> Policy:
    """The greedy policy of a run's `best` or `last` network.

    Raises:
        CheckpointError: as `load_network` does.
    """
    return load_saved_policy(run, checkpoint, config, world).policy


def greedy_policy(network: nn.Module, config: Config) -> Policy:
    """What the run's algorithm has this network do without exploration."""
    return _recipe(config).greedy_policy(network)


def _fits(state: object, wanted: Mapping[str, torch.Tensor]) -> bool:
    """Whether these are the network's parameters, by name, type and shape, all of them finite numbers."""
    return (
        isinstance(state, dict)
        and state.keys() == wanted.keys()
        and all(isinstance(state[name], torch.Tensor) and _alike(state[name], own) for name, own in wanted.items())
    )


def _alike(found: torch.Tensor, wanted: torch.Tensor) -> bool:
    kinds = (found.layout, found.dtype, found.device, found.shape)
    return kinds == (wanted.layout, wanted.dtype, wanted.device, wanted.shape) and bool(found.isfinite().all())


def _checked_device(name: str) -> torch.device:
    """The device of this name.

    Raises:
        ConfigError: torch has no such device here.
    """
    try:
        device = torch.device(name)
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError) as error:
        raise no_such_device(name) from error
    return device
