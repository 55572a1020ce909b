"""Run folders and payloads as a stranger might send them."""

import pickle
import resource
import subprocess
from functools import cache
from pathlib import Path

import yaml

from carrl.cli.main import main
from carrl.train.build import build_network, build_world
from carrl.train.checkpoint import save_checkpoint
from carrl.train.files import CONFIG, checkpoint_path
from tests.configs import compose

READ = ("track", "vehicle", "action", "sensor", "observation", "reward", "start", "env", "network", "seed")


MOST_GROWTH = 2**20
"""Of this process's memory while it refuses something, KiB."""


class Payload:
    """Runs a command when it is unpickled."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self):
        return subprocess.call, (["touch", str(self.marker)],)


def proves_harmful(marker: Path) -> bool:
    """Whether the payload does what it is meant to, where nobody takes care; removes its trace."""
    pickle.loads(pickle.dumps(Payload(marker)))
    harmed = marker.exists()
    marker.unlink(missing_ok=True)
    return harmed


@cache
def _untrained():
    config = {key: value for key, value in compose("experiment=smoke").items() if key in READ}
    return config, build_network(config, build_world(config)).state_dict()


def make_run(folder: Path, **nodes) -> Path:
    """The folder of an untrained run, with these nodes of its configuration replaced."""
    config, network = _untrained()
    save_checkpoint(checkpoint_path(folder, "best"), {"network": network})
    (folder / CONFIG).parent.mkdir()
    (folder / CONFIG).write_text(yaml.safe_dump(config | nodes))
    return folder


def refused(capsys, *arguments):
    """What `carrl` with these arguments says on stderr in one line, having exited with 2 and taken little memory."""
    capsys.readouterr()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert main([str(argument) for argument in arguments]) == 2
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < MOST_GROWTH
    printed = capsys.readouterr()
    assert printed.err.startswith("carrl: ")
    assert printed.err.count("\n") == 1
    assert len(printed.err) < 1000
    assert printed.err[:-1].isprintable()
    return printed.err
