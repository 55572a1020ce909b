"""`carrl export`: a run's greedy policy as a file that drives without CarRL."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from carrl.cli.parser import Parser, add_trust, named_folder

if TYPE_CHECKING:
    from carrl.export.policy import Exported

FORMATS = ("onnx", "torch", "npz", "c")
"""The keys of `carrl.export.policy.FORMATS`, which waits for torch."""


def main(argv: list[str]) -> int:
    """Writes the file, and says what it takes and gives."""
    arguments = _parser().parse_args(argv)
    import torch  # From here on it takes seconds.

    from carrl.export.policy import export_policy
    from carrl.train.run import Run

    torch.set_num_threads(1)
    run = Run.load(arguments.run, arguments.trust)
    exported = export_policy(run, arguments.format, arguments.out, arguments.seed, arguments.checkpoint)
    _print(exported)
    if not exported.is_verified:
        print(
            "warning: not compared with the run's policy: no C compiler (cc, gcc or clang) was found", file=sys.stderr
        )
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="carrl export",
        description="Writes the policy of a run, without exploration, as a file that drives without CarRL: it takes "
        "metres and metres a second, and gives the action and the controls in physical units. See docs/deploy.md.",
    )
    parser.add_argument("run", type=named_folder, metavar="RUN", help="the folder of a run")
    parser.add_argument(
        "--format",
        choices=FORMATS,
        default="onnx",
        help="an ONNX model (the default), a torch.export program, arrays for NumPy, or a C header",
    )
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="an older one is replaced (default: policy.onnx and the like in RUN)"
    )
    parser.add_argument("--seed", type=int, metavar="N", help="which one, of a run of several seeds")
    parser.add_argument("--checkpoint", choices=("best", "last"), default="best", help="which network (default: best)")
    add_trust(parser)
    return parser


def _print(exported: "Exported") -> None:
    from carrl.cli.text.terminal_table import print_table

    document = exported.document
    rows = [
        (
            direction,
            each["name"],
            " x ".join(map(str, each["shape"])) or "1",
            each["dtype"],
            each["unit"],
            each["meaning"],
        )
        for direction, part in (("in", "inputs"), ("out", "outputs"))
        for each in document[part]
    ]
    rows += [("", "", "", "", each["unit"], f"{each['name']}: {each['quantity']}") for each in document["controls"]]
    print_table(
        f"{exported.path}: seed {document['seed']}, {document['checkpoint']} network",
        ("", "name", "values", "type", "unit", "what"),
        rows,
        figures=(),
    )
