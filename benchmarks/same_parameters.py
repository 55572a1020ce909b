"""Whether two runs learnt the same parameters, bit for bit: python -m benchmarks.same_parameters RUN RUN.

Exit code 0 if they did, 1 if they did not, 2 if a run cannot be read. Runs of several seeds are compared seed by seed.
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from torch import Tensor

from carrl.errors import CarrlError
from carrl.train.checkpoint import load_checkpoint
from carrl.train.files import checkpoint_path, seed_folders

CHECKPOINTS = ("last", "best")


def first_difference(ours: Path, theirs: Path) -> str | None:
    """The first of the two runs' parameters that differs, in words; None if none does.

    Raises:
        CarrlError: a run or a checkpoint of it cannot be read.
    """
    pairs = [seed_folders(run) for run in (ours, theirs)]
    seeds = [[folder.name for folder in folders] if len(folders) > 1 else [] for folders in pairs]
    if seeds[0] != seeds[1]:
        return f"seeds: {', '.join(seeds[0]) or 'one'} here, {', '.join(seeds[1]) or 'one'} there"
    for folders in zip(*pairs, strict=True):
        for name in CHECKPOINTS:
            networks = [_network(checkpoint_path(folder, name)) for folder in folders]
            differing = _first_differing(*networks)
            if differing is not None:
                return f"{checkpoint_path(folders[0], name)}: {differing}"
    return None


def _network(path: Path) -> dict[str, Tensor]:
    network = load_checkpoint(path).get("network")
    if not isinstance(network, dict) or not all(isinstance(value, Tensor) for value in network.values()):
        raise CarrlError(f"checkpoint '{path}' has no network's parameters in it")
    return network


def _first_differing(ours: Mapping[str, Tensor], theirs: Mapping[str, Tensor]) -> str | None:
    """The key of a tensor that is not the same in both; zeros of either sign differ, and nan is the same as itself."""
    for key in dict.fromkeys([*ours, *theirs]):
        if key not in ours or key not in theirs or _bits(ours[key]) != _bits(theirs[key]):
            return key
    return None


def _bits(tensor: Tensor) -> tuple[object, ...]:
    return tensor.dtype, tensor.shape, tensor.contiguous().numpy().tobytes()


def main(arguments: Sequence[str] | None = None) -> int:
    """Compares the runs that are named on the command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.same_parameters", description=__doc__)
    parser.add_argument("runs", nargs=2, type=Path, metavar="RUN", help="a run's folder")
    try:
        difference = first_difference(*parser.parse_args(arguments).runs)
    except CarrlError as error:
        print(error, file=sys.stderr)
        return 2
    print("the same parameters" if difference is None else f"not the same: {difference}")
    return 0 if difference is None else 1


if __name__ == "__main__":
    sys.exit(main())
