"""`carrl watch`: a trained car drives, in a window, or as a page or a video."""

import argparse
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from carrl.cli.kept_drives import check_file, draw_best
from carrl.cli.parser import Parser, add_trust, check_fps
from carrl.errors import ConfigError, printable
from carrl.evaluation.asked import check_one_drives
from carrl.files import check_may_appear
from carrl.render.window import check_can_open
from carrl.tracks.names import check_may_exist
from carrl.train.files import checkpoint_path, load_config, seed_folders

if TYPE_CHECKING:
    from carrl.env.gym_env import GymTrackEnv
    from carrl.train.run import Run

ENDINGS = (".html", ".mp4", ".gif")
INSTEAD = "--out FILE.html, or .mp4, or .gif, needs no display"


def main(argv: list[str]) -> int:
    """Shows laps in a window until the person quits, and prints how they went; or writes one to a file."""
    arguments = _parser().parse_args(argv)
    config = _check(arguments)
    import torch  # From here on it takes seconds.

    torch.set_num_threads(1)
    from carrl.train.run import Run

    run = Run.load(arguments.run, arguments.trust)
    checkpoint = "last" if arguments.live else "best"
    if arguments.out is not None:
        _write(run, arguments.track, checkpoint, arguments.out)
        return 0
    from carrl.cli.show import Show
    from carrl.train.build import load_saved_policy

    env = _make_env(run, arguments.track)
    fps = 1 / env.task.simulator.vehicle.time_step if arguments.fps is None else arguments.fps
    show = Show(env, lambda: load_saved_policy(run.folder, checkpoint, config, run.world), fps, arguments.live, INSTEAD)
    for lap in show.play():
        print(lap)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="carrl watch",
        description="Lets a run's best network drive without exploration, lap after lap from places along the track, "
        "in a window; H shows the keys.",
    )
    parser.add_argument("run", metavar="RUN", help="the folder of a run of one seed")
    parser.add_argument("--track", metavar="NAME|FILE", help="default: where the run was tried out")
    parser.add_argument(
        "--live",
        action="store_true",
        help="the newest network instead, beside a run in progress: it is looked for before each lap",
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help="no window: write a lap from the start line as a page, .html, or as a video, .mp4 or .gif",
    )
    parser.add_argument("--fps", type=float, metavar="F", help="time steps a second; default: real time")
    add_trust(parser)
    return parser


def _check(arguments: argparse.Namespace) -> dict[str, Any]:
    """The run's configuration.

    Raises:
        CarrlError: a flag cannot be done as asked, or nothing here can open a window.
    """
    check_fps(arguments.fps)
    if arguments.fps is not None and arguments.out is not None:
        raise ConfigError("--fps has no effect beside --out; leave one of them out")
    if arguments.out is not None:
        check_file(arguments.out, "--out", ENDINGS)
        check_may_appear(arguments.out)
    if arguments.track is not None:
        check_may_exist(arguments.track)
    folders = seed_folders(Path(arguments.run))
    config = load_config(folders[0], arguments.trust)
    check_one_drives(len(folders))
    path = checkpoint_path(Path(arguments.run), "last" if arguments.live else "best")
    if not path.exists():
        raise ConfigError(f"'{path}' is not there yet; a run in progress has it from its first evaluation on")
    if arguments.out is None:
        check_can_open(INSTEAD)
    return config


def _write(run: "Run", track: str | None, checkpoint: str, out: Path) -> None:
    """Writes a lap from the start line."""
    tracks = [track] if track is not None else run.world.circuits.validation[:1]
    with tempfile.TemporaryDirectory(prefix="carrl-") as folder:
        log = Path(folder, "drive.mcap")
        run.evaluate(tracks, checkpoint=checkpoint, log=log)
        shown = draw_best(log, [out], f"{checkpoint} network of {run.folder.resolve().name}")
    print(printable(f"{out}: {shown}"))


def _make_env(run: "Run", track: str | None) -> "GymTrackEnv":
    from carrl.cli.drive import among
    from carrl.env.gym_env import GymTrackEnv

    world = run.world
    return GymTrackEnv(
        track or world.circuits.validation[0],
        render_mode="rgb_array",
        vehicle=world.vehicle,
        sensor=world.sensor,
        action=world.action,
        observation=world.observation,
        reward=world.reward,
        **among(world),
    )
