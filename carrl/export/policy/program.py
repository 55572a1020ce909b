"""The policy for torch: a `torch.export` program, and by way of that an ONNX model."""

import json
import logging
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from carrl.errors import CarrlError
from carrl.export.policy.graph import PolicyGraph, outputs_of

METADATA = "carrl.json"
"""Name of the metadata in a `torch.export` program; in an ONNX model it is the property `carrl`."""
_BATCH = 3  # of the example: torch takes 1 for a size that never changes


class PolicyModule(nn.Module):
    """What a `PolicyGraph` computes: a mapping of named inputs, each [B, ...], to one of named outputs."""

    def __init__(self, graph: PolicyGraph) -> None:
        super().__init__()
        self._document, self._names = graph.document, list(graph.arrays)
        for index, values in enumerate(graph.arrays.values()):
            self.register_buffer(f"array{index}", torch.from_numpy(values.copy()))
        self._own = nn.ModuleDict(dict(graph.own))  # type: ignore[arg-type]

    def forward(self, inputs: dict[str, Tensor]) -> dict[str, Tensor]:
        """The outputs."""
        arrays = {name: getattr(self, f"array{index}") for index, name in enumerate(self._names)}
        return dict(outputs_of(self._document, arrays, inputs, torch, dict(self._own.items())))


def example_inputs(document: Mapping[str, Any], batch: int) -> dict[str, np.ndarray]:
    """Inputs [batch, ...] of the right names, types and shapes, all zero."""
    return {each["name"]: np.zeros((batch, *each["shape"]), each["dtype"]) for each in document["inputs"]}


def write_program(path: Path, graph: PolicyGraph) -> None:
    """Writes a `torch.export` program, which takes a dict of inputs of any batch and gives a dict of outputs."""
    with _quiet():
        torch.export.save(_program(graph), path, extra_files={METADATA: json.dumps(graph.document)})


def write_onnx(path: Path, graph: PolicyGraph) -> None:
    """Writes an ONNX model with named inputs and outputs of any batch.

    Raises:
        CarrlError: a package for it is missing.
    """
    try:
        import onnx
        import onnxscript  # noqa: F401 (torch needs it and would say so in a page)
    except ImportError as error:
        raise CarrlError(
            f"ONNX needs {error.name}, which is not installed; pip install 'carrl[onnx]', or choose another --format"
        ) from error
    names = {kind: [each["name"] for each in graph.document[kind]] for kind in ("inputs", "outputs")}
    with _quiet():
        program = torch.onnx.export(
            _program(graph),
            dynamo=True,
            input_names=names["inputs"],
            output_names=names["outputs"],
            external_data=False,
            verbose=False,
        )
        assert program is not None  # as where no file is named
        model = program.model_proto
    _tidy(model)
    model.metadata_props.add(key="carrl", value=json.dumps(graph.document))
    model.doc_string = "A driving policy exported by CarRL; the metadata property carrl describes it, in JSON."
    onnx.checker.check_model(model)
    path.write_bytes(model.SerializeToString(deterministic=True))


def _program(graph: PolicyGraph) -> torch.export.ExportedProgram:
    module = PolicyModule(graph).eval()
    example = {name: torch.from_numpy(values) for name, values in example_inputs(graph.document, _BATCH).items()}
    batch = torch.export.Dim("batch")
    return torch.export.export(module, (example,), dynamic_shapes=({name: {0: batch} for name in example},))


def _tidy(model: Any) -> None:
    """Calls the batch `batch`, which torch 2.13 numbers, and removes its notes, which have places of source code."""
    for value in (*model.graph.input, *model.graph.output, *model.graph.value_info):
        del value.metadata_props[:]
        for size in value.type.tensor_type.shape.dim:
            if size.HasField("dim_param"):
                size.dim_param = "batch"
    for part in (*model.graph.node, *model.graph.initializer, model.graph, *model.functions):
        del part.metadata_props[:]
        part.doc_string = ""


@contextmanager
def _quiet() -> Iterator[None]:
    """Leaves out what torch 2.13 says of itself while it exports: that torchvision is missing, what it deprecates."""
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings(), torch.no_grad():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)
