"""`carrl train`: trains a policy and leaves its run's folder."""

import json
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import hydra
import torch
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from torchrl import logger as torchrl_logger

from carrl.config import build_node, config_dir
from carrl.env.track_env import TrackEnv
from carrl.errors import CarrlError, ConfigError
from carrl.run.agent_run import AgentRun
from carrl.run.build import Learning, World, build_offline_pipeline, build_pipeline, learns_from_logs
from carrl.run.folder import CONFIG, LAP, LEARNING_CURVE, LOG, RunFolder, write_text
from carrl.run.offline_folder import OfflineRunFolder
from carrl.run.offline_trainer import OfflineTrainer
from carrl.run.plan import TrainingPlan
from carrl.run.provenance import describe_run
from carrl.run.summary import summarise
from carrl.run.trainer import Trainer
from carrl.run.training import Training
from carrl.view.console import Display, OfflineDisplay, TrainingDisplay, print_summaries, print_summary
from carrl.view.lap import draw_lap
from carrl.view.learning_curve import draw_learning_curve


def main(argv: list[str]) -> int:
    """Runs Hydra on the overrides, for one run or, with -m, for many."""
    os.environ["HYDRA_FULL_ERROR"] = "1"  # errors come here instead of Hydra's own printer, which exits with 1
    sys.argv = ["carrl train", *(override for argument in argv for override in _name_files(argument))]
    failures: list[CarrlError] = []

    def job(config: DictConfig) -> None:
        try:
            _train(config)
        except CarrlError as error:  # kept from Hydra, which would print it in its own way and stop a sweep
            failures.append(error)

    try:
        hydra.main(version_base="1.3", config_path=str(config_dir()), config_name="train")(job)()
    except (HydraException, OmegaConfBaseException) as error:
        raise ConfigError(" ".join(str(error).split())) from error
    except OSError as error:
        raise CarrlError(f"the run's folder '{error.filename}' cannot be written: {error.strerror}") from error
    if failures:
        raise CarrlError("; ".join(dict.fromkeys(map(str, failures))))
    return 0


def _name_files(argument: str) -> list[str]:
    """Makes paths of files absolute and quotes them, as Hydra reads a path such as `seed=0/train.mcap` only quoted.

    `track=FILE` stands for the track group's option `file`; FILE,FILE sweeps. `data.path=[FILE,FILE]` is a list.
    """
    key, _, value = argument.partition("=")
    if key == "track" and all("." in path or os.sep in path for path in value.strip("'\"").split(",")):
        return ["track=file", f"track.name_or_path={_quote_paths(value)}"]
    if key == "track.folder" and value not in ("", "null"):
        return [f"track.folder={_quote_paths(value)}"]
    if key == "data.path" and value not in ("", "???", "[]"):
        is_list = value.startswith("[") and value.endswith("]")
        return [f"data.path=[{_quote_paths(value[1:-1])}]" if is_list else f"data.path={_quote_paths(value)}"]
    return [argument]


def _quote_paths(value: str) -> str:
    paths = [os.path.abspath(path.strip().strip("'\"")) for path in value.split(",")]
    return ",".join("'" + path.replace("'", "\\'") + "'" for path in paths)


def _train(config: DictConfig) -> None:
    torchrl_logger.setLevel("WARNING")
    values = _checked_values(config)
    torch.set_num_threads(values["threads"])
    path = Path(HydraConfig.get().runtime.output_dir)
    with ExitStack() as stack:
        if learns_from_logs(values):
            learning, trainer, display = _prepare_offline(values, config, path, stack)
            context = {"transitions": len(learning.replay_buffer)}
        else:
            learning, trainer, display = _prepare(values, config, path, stack)
            context = {}
        with _stopping_on_signals(trainer) as interrupted, display:
            trainer.run(display)
    track = learning.world.circuits.name
    summaries = [summarise(run, trainer, track=track, **context) for run in trainer.runs]
    for run, summary in zip(trainer.runs, summaries, strict=True):
        run.folder.write_summary(summary)
        if isinstance(trainer, Trainer):
            _draw_learning_curve(run)
        _draw_lap(learning.world, run)
    if learning.plan.seeds is None:
        print_summary(summaries[0], path)
    else:
        print_summaries(summaries, path)
    if interrupted:
        raise KeyboardInterrupt


def _checked_values(config: DictConfig) -> dict[str, Any]:
    """The configuration as plain values."""
    missing = sorted(OmegaConf.missing_keys(config))
    if missing:
        raise ConfigError(f"{missing[0]} has no value; give it one, as in carrl train ... {missing[0]}=FILE")
    values: dict[str, Any] = OmegaConf.to_container(config, resolve=True)  # type: ignore[assignment]
    if not isinstance(values["threads"], int) or values["threads"] < 1:
        raise ConfigError(f"threads is {values['threads']}; it must be a whole number of at least 1")
    return values


Prepared = tuple[Learning, Trainer | OfflineTrainer, Display[Any]]
"""What learns, what trains it, and what shows how it goes."""


def _prepare(values: dict[str, Any], config: DictConfig, path: Path, stack: ExitStack) -> Prepared:
    """A training run in the simulator, its folders opened."""
    pipeline = build_pipeline(values)
    plan, folders = pipeline.plan, []
    for agent in pipeline.agents:
        own_path, own_config = _folder_of(path, config, plan, agent.seed)
        log = _open_log(own_path, own_config, pipeline.env, agent.seed, len(pipeline.agents))
        folders.append(stack.enter_context(RunFolder(own_path, log)))
    return pipeline, Trainer(pipeline, folders), TrainingDisplay(plan.frames, plan.episodes)


def _prepare_offline(values: dict[str, Any], config: DictConfig, path: Path, stack: ExitStack) -> Prepared:
    """A training run on logs, its folders opened."""
    pipeline = build_offline_pipeline(values)
    paths = [_folder_of(path, config, pipeline.plan, agent.seed)[0] for agent in pipeline.agents]
    folders = [stack.enter_context(OfflineRunFolder(own_path)) for own_path in paths]
    display = OfflineDisplay(pipeline.offline_plan.updates, len(pipeline.replay_buffer))
    return pipeline, OfflineTrainer(pipeline, folders), display


def _folder_of(path: Path, config: DictConfig, plan: TrainingPlan, seed: int) -> tuple[Path, DictConfig]:
    """Where the agent with this seed leaves its results, and its configuration as if trained alone.

    That is the run's own folder, or one below it where there are several agents.
    """
    if plan.seeds is None:
        return path, config
    config = OmegaConf.merge(config, {"seed": seed, "trainer": {"seeds": None}})  # type: ignore[assignment]
    path = path / f"seed={seed}"
    (path / CONFIG).parent.mkdir(parents=True, exist_ok=True)
    write_text(path / CONFIG, OmegaConf.to_yaml(config))
    return path, config


def _open_log(path: Path, config: DictConfig, env: TrackEnv, seed: int, agents: int) -> Any:
    if not config.get("recorder"):
        return None
    return build_node(
        "recorder",
        OmegaConf.to_container(config.recorder),  # type: ignore[arg-type]
        path=path / LOG,
        attachments={
            "config.yaml": OmegaConf.to_yaml(config, resolve=True).encode(),
            **{
                f"track-{index}.json" if index else "track.json": json.dumps(track.as_dict()).encode()
                for index, track in enumerate(env.tracks)
            },
        },
        metadata=describe_run(env, seed, env.batch_size[0] // agents),
    )


@contextmanager
def _stopping_on_signals(trainer: Training) -> Iterator[list[int]]:
    """Lets the first SIGINT or SIGTERM end the run with everything saved, and the second end the process."""
    received: list[int] = []

    def stop(number: int, _frame: object) -> None:
        if received:
            raise KeyboardInterrupt
        received.append(number)
        trainer.stop()

    previous = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield received
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def _draw_learning_curve(run: AgentRun) -> None:
    first_lap = run.first_lap.episode if run.first_lap else None
    draw_learning_curve(run.folder.path / LEARNING_CURVE, run.episode_returns, first_lap_episode=first_lap)


def _draw_lap(world: World, run: AgentRun) -> None:
    if run.best is not None:
        best, track = run.best.drives[run.best.shown], world.circuits.validation[run.best.shown]
        draw_lap(
            run.folder.path / LAP,
            track,
            best.poses,
            best.ranges,
            world.sensor.angles.numpy(),
            best.actions,
            body_radius=world.vehicle.body_radius,
            title=f"{track.name}: best greedy drive, reward {best.lap_reward:.0f}, {best.lap_steps} steps",
            collided=best.collided,
        )
