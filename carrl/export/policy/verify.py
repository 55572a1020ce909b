"""Tries an exported policy out beside the one that it was made of, on random inputs.

Our own policy gets what the world's own observation terms make of the inputs, so that names, units, order and
normalisation are tried with the network.

Shapes: `B` cars, `O` values of an observation.
"""

import shutil
import subprocess
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from carrl.algorithms.algorithm import Policy
from carrl.errors import CarrlError
from carrl.export.policy.graph import Document, controls_of
from carrl.export.policy.inputs import readings_of
from carrl.task.observation import ObservationTerm
from carrl.task.task import World

Arrays = dict[str, np.ndarray]
BATCHES = (1, 4, 7)
TOLERANCE = 1e-5
"""Of actions and controls that are numbers, as shares of their largest size, or of 1."""
TIE = 1e-5
"""As a share of the values' size: two actions so near to each other are equally good."""


def verify(compute: Callable[[Arrays], Arrays], document: Document, policy: Policy, world: World) -> None:
    """Compares the exported policy with our own at batches of `BATCHES`.

    Args:
        compute: inputs by name, each [B, ...], to outputs by name.
        document: of the policy.
        policy: our own.
        world: that it was trained in.

    Raises:
        CarrlError: they differ.
    """
    generator = np.random.default_rng(0)
    for batch in BATCHES:
        inputs = random_inputs(document, world, batch, generator)
        found = compute(inputs)
        with torch.no_grad():
            action = policy(observation_of(world, inputs))
            settings = world.action.controls(action).numpy()
        differs = difference(found, action.numpy(), controls_of(document, settings, inputs, np))
        if differs:
            raise CarrlError(
                f"the exported policy is not the run's own: of {batch} cars, {differs}; please report this, for it is "
                "a fault of CarRL or of the exporter"
            )


def difference(found: Mapping[str, np.ndarray], action: np.ndarray, controls: np.ndarray) -> str:
    """What differs from our own action [B, ...] and controls [B, C]; nothing if nothing does."""
    chosen = found["action"]
    if chosen.shape != action.shape or found["controls"].shape != controls.shape:
        return f"actions have the shape {list(chosen.shape)} instead of {list(action.shape)}"
    same = np.ones(len(action), bool)
    if "action_value" in found:
        values, rows = found["action_value"], np.arange(len(action))
        if not np.isfinite(values).all():
            return "the values of actions are not all numbers"
        same = chosen == action
        lost = np.abs(values[rows, chosen] - values[rows, action])
        wrong = int((~same & (lost > TIE * np.abs(values).max(axis=-1))).sum())
        if wrong:
            return f"{wrong} have another action"
    elif not np.allclose(chosen, action, atol=TOLERANCE, rtol=0):
        return f"actions differ by {np.abs(chosen - action).max():.3g}"
    size = np.maximum(1, np.abs(controls).max(axis=0))
    if not np.allclose((found["controls"] / size)[same], (controls / size)[same], atol=2 * TOLERANCE, rtol=0):
        return "the controls differ"
    return ""


def random_inputs(document: Document, world: World, batch: int, generator: np.random.Generator) -> Arrays:
    """Inputs by name, each [batch, ...], of the size that the policy is used to; some rays have no echo."""
    sizes = {each["input"]: each["divisor"] / each["factor"] for each in document["observation"] if "input" in each}
    sizes |= {"speed": float(getattr(world.vehicle, "max_speed", 10.0)), "slip": 0.2}
    inputs: Arrays = {}
    for each in document["inputs"]:
        name, shape = each["name"], (batch, *each["shape"])
        if name in ("rays", "previous_rays"):
            most = document["sensor"]["max_range_m"]
            ranges = most * generator.uniform(0, 1.2, shape)
            values = np.where(generator.uniform(size=shape) < 0.05, np.inf, ranges)
        elif each["dtype"] == "int64":
            values = generator.integers(0, len(document["actions"]), shape)
        elif name == "contact":
            values = generator.integers(0, 2, shape)
        elif name == "speed":
            values = sizes[name] * generator.uniform(0, 1, shape)
        else:
            values = sizes.get(name, 1.0) * generator.uniform(-1, 1, shape)
        inputs[name] = values.astype(each["dtype"])
    return inputs


def observation_of(world: World, inputs: Mapping[str, np.ndarray]) -> Tensor:
    """What the world's own terms would tell a driver, [B, O], where the sensors measure these inputs."""
    told = {name: torch.from_numpy(values) for name, values in inputs.items()}
    readings = readings_of(world.observation, world.sensor, world.action)
    context = _moment(world, told)
    values = []
    for (name, term), reading in zip(world.observation.terms.items(), readings, strict=True):
        if not type(term).__module__.startswith("carrl."):
            values.append(told[name])
        else:
            values.append(_ask(term, context, world, told, int(reading.document.get("count", 1))))
    return torch.cat(values, dim=-1)


def _ask(term: ObservationTerm, context: Any, world: World, told: Mapping[str, Tensor], scans: int) -> Tensor:
    seen = None
    if scans > 1:
        ranges = torch.cat([told["previous_rays"][:, : scans - 1], told["rays"][:, None]], dim=1)
        seen = world.sensor.readings(_measured(ranges, world)).flatten(1)  # the last of which is forgotten
    return term(SimpleNamespace(**vars(context), seen=seen, value=context.find))  # type: ignore[arg-type]


def _measured(ranges: Tensor, world: World) -> Tensor:
    """Distances that a sensor finds: none is beyond its range."""
    return ranges.clamp(0, world.sensor.max_range)


def _moment(world: World, told: Mapping[str, Tensor]) -> Any:
    """An `ObservationContext` of nowhere, with an exact sensor, for the terms that are CarRL's."""
    count = len(next(iter(told.values())))
    first = world.action.first.expand(count, *world.action.first.shape)
    last_action = told.get("last_action", first)
    contact = told["contact"] > 0 if "contact" in told else None
    place = SimpleNamespace(
        heading_error=told.get("heading_error"), side=told.get("track_position"), station=torch.zeros(count)
    )
    places = SimpleNamespace(curvatures=lambda *_: told["curvatures"])
    simulator = SimpleNamespace(
        sensor=replace(world.sensor, noise=0.0, dropout=0.0), vehicle=world.vehicle, places=places
    )
    return SimpleNamespace(
        state=SimpleNamespace(
            last_action=last_action, contact=contact, cars=SimpleNamespace(track=torch.zeros(count, dtype=torch.int64))
        ),
        ranges=_measured(told["rays"], world) if "rays" in told else torch.zeros(count, world.sensor.rays),
        simulator=simulator,
        action=world.action,
        streams=None,
        wanted=None,
        place=place,
        find=lambda entry: told[entry] if entry in told else torch.zeros(count),
    )


def compiled_header(path: Path, name: str, document: Document, folder: Path) -> Callable[[Arrays], Arrays] | None:
    """What a C header computes, by a program that is compiled in a folder; None where there is no C compiler.

    Raises:
        CarrlError: it does not compile.
    """
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        return None
    source, program = folder / "try.c", folder / "try"
    source.write_text(
        f'#include <stdio.h>\n#include "{path.name}"\n'
        f"int main(void) {{ {name}_inputs inputs; {name}_outputs outputs;\n"
        f"while (fread(&inputs, sizeof inputs, 1, stdin) == 1) {{\n"
        f"{name}_act(&inputs, &outputs); fwrite(&outputs, sizeof outputs, 1, stdout); }} return 0; }}\n"
    )
    command = [compiler, "-std=c99", "-O1", "-I", str(path.parent), "-o", str(program), str(source), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise CarrlError(f"{compiler} does not compile the exported header: {done.stderr.strip()[:200]}")
    kinds = {"float32": "<f4", "int64": "<i4"}
    inputs_type, outputs_type = (
        np.dtype([(each["name"], kinds[each["dtype"]], tuple(each["shape"])) for each in document[part]])
        for part in ("inputs", "outputs")
    )

    def compute(inputs: Arrays) -> Arrays:
        rows = np.zeros(len(next(iter(inputs.values()))), inputs_type)
        for each, values in inputs.items():
            rows[each] = values
        printed = subprocess.run([program], input=rows.tobytes(), capture_output=True, check=True).stdout
        found = np.frombuffer(printed, outputs_type)
        return {each: found[each] for each in outputs_type.names or ()}

    return compute


def scratch() -> "tempfile.TemporaryDirectory[str]":
    """A folder for what is compiled."""
    return tempfile.TemporaryDirectory(prefix="carrl-")
