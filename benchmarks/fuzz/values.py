"""Plain values as a config or a summary might hold them by mistake or by malice, and trees with such values in them."""

import math
from random import Random
from typing import Any

VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, 1, -1, 2, 7, 10, 100, 4096, 10**6, 2**31, 2**53, 2**63, 2**64, 10**40, -(10**40)),
    *(0.0, -0.0, 0.1, 0.5, 1.5, 1e-9, 1e-300, 1e9, 1e15, 1e300, math.nan, math.inf, -math.inf),
    *("", "7", "nan", "paper", "oval", "/dev/zero", "/dev/null", "/etc/passwd", "/", ".", "\x1b[2J", "a" * 5000),
    *([], {}, [[]], [1, 2], [8.0, 20.0], [64, 32], [-1], [0], [10**9], [10**5] * 100, ["a"], [None], [math.nan]),
    *(
        {"a": 1},
        [math.inf, 1.0],
        [5.0, 1.0],
        [1] * 5000,
        "0..9",
        "0..99999999999",
        "a\x00b",
        "\ud800".encode("utf-8", "replace").decode(),
    ),
)
TARGETS = (
    *("os.system", "subprocess.run", "builtins.eval", "builtins.open", "carrl.train.files.write_text", "shutil.rmtree"),
    *(
        "carrl.log.writer.LogWriter",
        "carrl.files.write_whole",
        "carrl.tracks.track.Track.random",
        "carrl.cli.main.main",
    ),
    *(
        "carrl.tracks.track.Track.load",
        "carrl.sim.vehicle.Bicycle",
        "carrl.sim.vehicle.Vehicle",
        "carrl.nothing",
        "",
        ".",
    ),
    *("torch.optim.Adam", "torch.load", "carrl.tracks.track.Track", "carrl.config.inspect.os.system", "carrl"),
)
LONGEST = 100_000
"""Items of a list that is made longer; as a file that is more than any parser takes."""


def change(draw: Random, tree: Any) -> Any:
    """A copy of a tree of dicts and lists with one value changed, taken away, renamed or added."""
    if not isinstance(tree, dict | list) or not tree or draw.random() < 0.1:
        return draw.choice(VALUES)
    copy = tree.copy()
    key = draw.choice(list(copy)) if isinstance(copy, dict) else draw.randrange(len(copy))
    way = draw.random()
    if key == "_target_" and way < 0.8:
        copy[key] = draw.choice(TARGETS)
    elif way < 0.7:
        copy[key] = change(draw, copy[key])
    elif way < 0.8:
        del copy[key]
    elif isinstance(copy, dict):
        new = draw.choice((*copy, "seed", "generator", "self", "_args_", "a b", 7, None))
        copy[new] = draw.choice(VALUES)
    else:
        copy = (copy * draw.choice((2, 3, 500)))[:LONGEST]
    return copy
