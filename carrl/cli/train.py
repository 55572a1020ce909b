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
from carrl.run.build import Pipeline, World, build_pipeline
from carrl.run.folder import CONFIG, LAP, LEARNING_CURVE, LOG, RunFolder, write_text
from carrl.run.provenance import describe_run
from carrl.run.summary import summarise
from carrl.run.trainer import Trainer
from carrl.view.console import TrainingDisplay, print_summaries, print_summary
from carrl.view.lap import draw_lap
from carrl.view.learning_curve import draw_learning_curve


def main(argv: list[str]) -> int:
    """Runs Hydra on the overrides, for one run or, with -m, for many."""
    os.environ["HYDRA_FULL_ERROR"] = "1"  # errors come here instead of Hydra's own printer, which exits with 1
    sys.argv = ["carrl train", *(override for argument in argv for override in _name_track_file(argument))]
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


def _name_track_file(argument: str) -> list[str]:
    """Lets `track=FILE` stand for the track group's option `file`, with the path made absolute; FILE,FILE sweeps."""
    key, _, value = argument.partition("=")
    paths = value.strip("'\"").split(",")
    if key != "track" or not all("." in path or os.sep in path for path in paths):
        return [argument]
    quoted = ["'" + os.path.abspath(path).replace("'", "\\'") + "'" for path in paths]
    return ["track=file", f"track.name_or_path={','.join(quoted)}"]


def _train(config: DictConfig) -> None:
    torchrl_logger.setLevel("WARNING")
    values: dict[str, Any] = OmegaConf.to_container(config, resolve=True, throw_on_missing=True)  # type: ignore[assignment]
    if not isinstance(values["threads"], int) or values["threads"] < 1:
        raise ConfigError(f"threads is {values['threads']}; it must be a whole number of at least 1")
    torch.set_num_threads(values["threads"])
    path = Path(HydraConfig.get().runtime.output_dir)
    pipeline = build_pipeline(values)
    plan = pipeline.plan
    with ExitStack() as stack:
        folders = [stack.enter_context(_open_folder(path, config, pipeline, agent.seed)) for agent in pipeline.agents]
        trainer = Trainer(pipeline, folders)
        with _stopping_on_signals(trainer) as interrupted, TrainingDisplay(plan.frames, plan.episodes) as display:
            trainer.run(display)
    track = pipeline.world.track.name
    summaries = [summarise(run, trainer, track=track) for run in trainer.runs]
    for run, summary in zip(trainer.runs, summaries, strict=True):
        run.folder.write_summary(summary)
        _draw(pipeline.world, run)
    if plan.seeds is None:
        print_summary(summaries[0], path)
    else:
        print_summaries(summaries, path)
    if interrupted:
        raise KeyboardInterrupt


def _open_folder(path: Path, config: DictConfig, pipeline: Pipeline, seed: int) -> RunFolder:
    """The folder of the agent with this seed: the run's own, or one below it that looks as if trained alone."""
    if pipeline.plan.seeds is not None:
        config = OmegaConf.merge(config, {"seed": seed, "trainer": {"seeds": None}})  # type: ignore[assignment]
        path = path / f"seed={seed}"
        (path / CONFIG).parent.mkdir(parents=True, exist_ok=True)
        write_text(path / CONFIG, OmegaConf.to_yaml(config))
    return RunFolder(path, _open_log(path, config, pipeline.env, seed, len(pipeline.agents)))


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
def _stopping_on_signals(trainer: Trainer) -> Iterator[list[int]]:
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


def _draw(world: World, run: AgentRun) -> None:
    path = run.folder.path
    first_lap = run.first_lap.episode if run.first_lap else None
    draw_learning_curve(path / LEARNING_CURVE, run.episode_returns, first_lap_episode=first_lap)
    best = run.best
    if best is not None:
        draw_lap(
            path / LAP,
            world.track,
            best.poses,
            best.ranges,
            world.sensor.angles.numpy(),
            best.actions,
            body_radius=world.vehicle.body_radius,
            title=f"{world.track.name}: best greedy drive, reward {best.lap_reward:.0f}, {best.lap_steps} steps",
            collided=best.collided,
        )
