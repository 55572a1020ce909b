"""One training run from its configuration to its pictures."""

import json
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
import yaml
from torchrl import logger as torchrl_logger

from carrl.cli.road_warning import warn_of_roads
from carrl.cli.signals import stopping_on_signals
from carrl.cli.text.console import Display, OfflineDisplay, Silence, TrainingDisplay, print_summaries, print_summary
from carrl.config import build_node, is_whole_number
from carrl.errors import CarrlError, CheckpointError, ConfigError, shown
from carrl.log.writer import LogWriter
from carrl.task.task import World
from carrl.train.agent_run import AgentRun
from carrl.train.build import Learning, Pipeline, build_offline_pipeline, build_pipeline, learns_from_logs
from carrl.train.files import CONFIG, LAP, LEARNING_CURVE, LOG, write_text
from carrl.train.folder import RunFolder, check_tables
from carrl.train.inputs import Inputs, check_inputs, checksums
from carrl.train.offline_folder import OfflineRunFolder
from carrl.train.offline_trainer import OfflineTrainer
from carrl.train.provenance import describe_run
from carrl.train.scalars import Scalars
from carrl.train.state_file import StateFile
from carrl.train.summary import summarise
from carrl.train.trainer import Trainer

Config = dict[str, Any]
MOST_THREADS = 1024
"""More than any machine has cores; torch takes no number of more than 31 bits."""


@dataclass(frozen=True)
class Session:
    """What learns, what trains it, what shows how it goes, and what else to note of it."""

    learning: Learning
    trainer: Trainer | OfflineTrainer
    display: Display[Any]
    context: Mapping[str, Any] = field(default_factory=dict)


def train(
    config: Config, path: Path, state: dict[str, Any] | None = None, display: Display[Any] | Silence | None = None
) -> list[dict[str, Any]]:
    """Trains, leaves the results in the run's folder, and returns every agent's summary.

    Args:
        config: resolved, as plain values.
        path: the run's folder.
        state: of a run that was broken off, to go on with it; None to begin.
        display: what to call after every round instead of showing progress and results on the terminal.

    Raises:
        CarrlError: whatever ended the run before its time.
        KeyboardInterrupt: a signal did, with everything saved.
    """
    torchrl_logger.setLevel("WARNING")
    torch.set_num_threads(_checked_threads(config["threads"]))
    with _naming_exhaustion(), ExitStack() as stack:
        prepare = _prepare_offline if learns_from_logs(config) else _prepare
        try:
            session = prepare(config, path, state, stack)
        except (KeyError, TypeError, IndexError, AttributeError) as error:
            if state is None:
                raise
            raise CheckpointError(f"run '{path}': the state does not fit the run's configuration: {error}") from error
        if state is not None:
            session.trainer.load_state_dict(state)
        warn_of_roads(session.learning.world.circuits.all, session.learning.world)
        shown = display or session.display
        with stopping_on_signals(session.trainer), shown, suppress(KeyboardInterrupt):
            session.trainer.run(shown)
        summaries = _write_summaries(session)
    if session.trainer.stopping:
        if display is None:
            print(f"interrupted; everything is saved: go on with carrl train resume={path}")
        raise KeyboardInterrupt
    for run in session.trainer.runs:
        if isinstance(session.trainer, Trainer):
            _draw_learning_curve(run)
        _draw_lap(session.learning.world, run)
    if display is None:
        _print(summaries, session, path)
    return summaries


def _checked_threads(threads: Any) -> int:
    """The number of threads.

    Raises:
        ConfigError: it is none.
    """
    if not is_whole_number(threads) or not 1 <= threads <= MOST_THREADS:
        raise ConfigError(f"threads is {shown(threads)}; it must be a whole number from 1 to {MOST_THREADS}")
    return int(threads)


def _print(summaries: list[dict[str, Any]], session: Session, path: Path) -> None:
    if session.learning.plan.seeds is None:
        print_summary(summaries[0], path)
    else:
        print_summaries(summaries, path)


def _prepare(config: Config, path: Path, state: Mapping[str, Any] | None, stack: ExitStack) -> Session:
    """A training run in the simulator, its folders opened."""
    pipeline = build_pipeline(config)
    inputs = checksums(pipeline.world.circuits)
    _check_is_as_left(path, config, pipeline, inputs, state)
    _write_config(path, config)
    plan, folders = pipeline.plan, []
    state_file = StateFile(path, config, plan.checkpoint_interval, inputs)
    for index, agent in enumerate(pipeline.agents):
        own_path, own_config = _folder_of(path, config, agent.seed)
        own_state, scalars = state["folders"][index] if state else None, _open_scalars(own_path, own_config)
        log = _open_log(own_path, own_config, pipeline, agent.seed, own_state, state_file)
        if log is not None:
            stack.enter_context(log)  # which completes it where the folder is refused
        folders.append(stack.enter_context(RunFolder(own_path, log, own_state, scalars)))
    trainer = Trainer(pipeline, folders, state_file)
    return Session(pipeline, trainer, TrainingDisplay(plan.frames, plan.episodes))


def _prepare_offline(config: Config, path: Path, state: Mapping[str, Any] | None, stack: ExitStack) -> Session:
    """A training run on logs, its folders opened."""
    pipeline = build_offline_pipeline(config)
    inputs = checksums(pipeline.world.circuits, pipeline.offline_plan.paths)
    _check_is_as_left(path, config, pipeline, inputs, state)
    _write_config(path, config)
    state_file = StateFile(path, config, pipeline.plan.checkpoint_interval, inputs)
    folders = []
    for index, agent in enumerate(pipeline.agents):
        own_path, own_config = _folder_of(path, config, agent.seed)
        own_state, scalars = state["folders"][index] if state else None, _open_scalars(own_path, own_config)
        folders.append(stack.enter_context(OfflineRunFolder(own_path, state=own_state, scalars=scalars)))
    trainer = OfflineTrainer(pipeline, folders, state_file)
    transitions = len(pipeline.replay_buffer)
    display = OfflineDisplay(pipeline.offline_plan.updates, transitions)
    return Session(pipeline, trainer, display, {"transitions": transitions})


def _check_is_as_left(
    path: Path, config: Config, learning: Learning, inputs: Inputs, state: Mapping[str, Any] | None
) -> None:
    """Refuses, before anything is written, what is not as the state's run had it."""
    if state is None:
        return
    check_inputs(path, state["inputs"], inputs)
    for index, agent in enumerate(learning.agents):
        check_tables(_path_of(path, config, agent.seed), state["folders"][index])


def _path_of(path: Path, config: Config, seed: int) -> Path:
    return path if config["trainer"].get("seeds") is None else path / f"seed={seed}"


def _folder_of(path: Path, config: Config, seed: int) -> tuple[Path, Config]:
    """Where the agent with this seed leaves its results, and its configuration as if trained alone.

    That is the run's own folder, or one below it where there are several agents.
    """
    if config["trainer"].get("seeds") is not None:
        path = _path_of(path, config, seed)
        config = {**config, "seed": seed, "trainer": {**config["trainer"], "seeds": None}}
        _write_config(path, config)
    return path, config


def _write_config(path: Path, config: Config) -> None:
    try:
        (path / CONFIG).parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CarrlError(f"the run's folder '{path}' cannot be written: {error.strerror}") from error
    write_text(path / CONFIG, _as_yaml(config))


def _open_log(
    path: Path, config: Config, pipeline: Pipeline, seed: int, state: Mapping[str, Any] | None, state_file: StateFile
) -> LogWriter | None:
    if not config.get("recorder"):
        return None
    env, agents = pipeline.env, len(pipeline.agents)
    log: LogWriter = build_node(
        "recorder",
        config["recorder"],
        path=path / LOG,
        attachments={
            "config.yaml": _as_yaml(config).encode(),
            **{
                f"track-{index}.json" if index else "track.json": json.dumps(track.as_dict()).encode()
                for index, track in enumerate(env.tracks)
            },
        },
        metadata=describe_run(env, seed, env.batch_size[0] // agents),
        state=state["log"] if state else None,
        make_room=state_file.make_room,
    )
    return log


def _open_scalars(path: Path, config: Config) -> Scalars | None:
    if not config.get("logger"):
        return None
    scalars: Scalars = build_node("logger", config["logger"], folder=path, config=config)
    return scalars


def _as_yaml(config: Config) -> str:
    return yaml.safe_dump(config, sort_keys=False)


def _write_summaries(session: Session) -> list[dict[str, Any]]:
    track, trainer = session.learning.world.circuits.name, session.trainer
    summaries = [summarise(run, trainer, track=track, **session.context) for run in trainer.runs]
    for run, summary in zip(trainer.runs, summaries, strict=True):
        run.folder.write_summary(summary)
    return summaries


@contextmanager
def _naming_exhaustion() -> Iterator[None]:
    """Turns what Python, numpy and torch raise when memory runs out into one sentence."""
    try:
        yield
    except MemoryError as error:
        raise _exhausted() from error
    except RuntimeError as error:  # torch's own for the CPU; for a GPU a kind of it
        if isinstance(error, torch.OutOfMemoryError) or "allocate memory" in str(error):
            raise _exhausted() from error
        raise


def _exhausted() -> CarrlError:
    return CarrlError(
        "out of memory; set a smaller replay_buffer.capacity, env.num_envs or trainer.seeds, and train anew, or, "
        "if other programs took the memory, go on with resume="
    )


def _draw_learning_curve(run: AgentRun) -> None:
    from carrl.render.learning_curve import draw_learning_curve  # Here, since Matplotlib takes long to import.

    first_lap = run.first_lap.episode if run.first_lap else None
    draw_learning_curve(run.folder.path / LEARNING_CURVE, run.episode_returns, first_lap_episode=first_lap)


def _draw_lap(world: World, run: AgentRun) -> None:
    from carrl.render.lap import draw_lap  # brings Matplotlib

    if run.best is not None:
        best, track = run.best.rollouts[run.best.shown], world.circuits.validation[run.best.shown]
        draw_lap(
            run.folder.path / LAP,
            track,
            best.poses,
            best.ranges,
            world.sensor.angles.numpy(),
            best.actions,
            action_names=world.action.names,
            body_radius=world.vehicle.body_radius,
            title=f"{track.name}: best greedy drive, reward {best.lap_reward:.0f}, {best.lap_steps} steps",
            collided=best.collided,
        )
