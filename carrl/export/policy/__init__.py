"""A run's greedy policy as a file that drives without CarRL: ONNX, a torch program, arrays, or a C header."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from carrl.algorithms.algorithm import Policy
from carrl.errors import CarrlError, ConfigError, shown
from carrl.export.policy.arrays import write_arrays
from carrl.export.policy.build import policy_graph
from carrl.export.policy.graph import PolicyGraph
from carrl.export.policy.header import identifier, write_header
from carrl.export.policy.loaded import load_policy
from carrl.export.policy.program import write_onnx, write_program
from carrl.export.policy.verify import compiled_header, scratch, verify
from carrl.files import check_may_appear, write_whole
from carrl.task.task import World
from carrl.train.build import ANY_TRACK, build_world, greedy_policy, load_network
from carrl.train.run import Run

FORMATS = {"onnx": ".onnx", "torch": ".pt2", "npz": ".npz", "c": ".h"}
"""Of files by their names: what those end in."""


@dataclass(frozen=True)
class Exported:
    """What was written.

    Attributes:
        path: of the file.
        document: its metadata.
        is_verified: whether it was compared with the run's own policy, which a C header is only where there is a C
            compiler.
    """

    path: Path
    document: Mapping[str, Any]
    is_verified: bool


def export_policy(
    run: Run, format: str = "onnx", out: str | Path | None = None, seed: int | None = None, checkpoint: str = "best"
) -> Exported:
    """Writes the greedy policy of a run, and tries it out beside the run's own.

    Args:
        run: whose policy it is.
        format: one of `FORMATS`.
        out: the file, whose name ends in what the format's do; an older one is replaced. None for `policy.onnx` and
            the like in the run's folder.
        seed: which one, where the run has several.
        checkpoint: which network, `best` or `last`.

    Raises:
        CarrlError: there is no such format, seed or checkpoint, the run is damaged, a package is missing, the file
            cannot be written, or does not do what the run's policy does.
    """
    if format not in FORMATS:
        raise ConfigError(f"format is {shown(format)}; it must be {', '.join(FORMATS)}")
    one = _of_seed(run, seed)
    path = one.folder / f"policy{FORMATS[format]}" if out is None else Path(out)
    if path.suffix != FORMATS[format]:
        raise ConfigError(f"'{path}' is no name for the format {format}; it must end in {FORMATS[format]}")
    check_may_appear(path)
    world = build_world({**one.config, "track": ANY_TRACK})
    network = load_network(one.folder, checkpoint, one.config, world)
    about = {"run": str(one.folder), "seed": one.config["seed"], "checkpoint": checkpoint}
    graph = policy_graph(network, world, about)
    if format in ("npz", "c") and graph.own:
        types = ", ".join(type(each).__name__ for each in graph.own.values())
        raise ConfigError(
            f"the network has layers that the format {format} does not know: {types}; choose onnx or torch"
        )
    with scratch() as folder:
        draft = Path(folder) / f"policy{FORMATS[format]}"  # whatever a C compiler may think of the file's own name
        is_verified = _write(draft, format, identifier(path.stem), graph, greedy_policy(network, one.config), world)
        write_whole(path, draft.read_bytes())
    return Exported(path, graph.document, is_verified)


def _write(draft: Path, format: str, name: str, graph: PolicyGraph, policy: Policy, world: World) -> bool:
    """Writes a file, and compares it with our own policy if that is possible; in C its names begin with `name`."""
    if format == "c":
        write_header(draft, graph, name)
        compute = compiled_header(draft, name, graph.document, draft.parent)
        if compute is None:
            return False
        verify(compute, graph.document, policy, world)
        return True
    {"onnx": write_onnx, "torch": write_program, "npz": write_arrays}[format](draft, graph)
    loaded = load_policy(draft)
    verify(lambda inputs: loaded(**inputs), graph.document, policy, world)
    return True


def _of_seed(run: Run, seed: int | None) -> Run:
    """The run of one seed."""
    seeds = {each.config["seed"]: each for each in run.replicates}
    if seed is None and len(seeds) > 1:
        raise CarrlError(
            f"'{run.folder}' has the seeds {', '.join(map(str, seeds))}; choose one, such as --seed {min(seeds)}"
        )
    if seed is not None and seed not in seeds:
        raise CarrlError(f"'{run.folder}' has no seed {seed}; it has {', '.join(map(str, seeds))}")
    return next(iter(seeds.values())) if seed is None else seeds[seed]
