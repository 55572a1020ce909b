"""A policy as a list of steps from named inputs to named outputs, which NumPy and torch compute alike.

`document` is JSON and `arrays` are the numbers that it names. Of the document, these keys say what is computed:
`observation`, whose readings stand side by side; `network`, layer by layer; `action`; and `controls`.

Shapes: `B` cars, `O` values of an observation, `K` values of actions, `C` controls.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

Values = Any
"""Arrays of NumPy or tensors of torch, as the caller has them."""
Document = Mapping[str, Any]
Arrays = Mapping[str, Values]
Own = Mapping[str, Callable[[Values], Values]]
NONE: Own = MappingProxyType({})


@dataclass(frozen=True)
class PolicyGraph:
    """A policy.

    Attributes:
        document: what it is told, what it computes, and what it was trained with.
        arrays: by the names that the document has for them, float32.
        own: layers that are not CarRL's, by name; only torch knows them.
    """

    document: Document
    arrays: Mapping[str, np.ndarray]
    own: Own


def outputs_of(document: Document, arrays: Arrays, inputs: Mapping[str, Values], xp: Any, own: Own = NONE) -> Arrays:
    """The action, the values of all actions if there are such, and the controls in physical units.

    Args:
        document: of the policy.
        arrays: of the policy, of the same library as the inputs.
        inputs: by name, each [B, ...].
        xp: the library: numpy or torch.
        own: layers that are not CarRL's.

    Returns:
        `action` [B], int64, and `action_value` [B, K], or `action` [B, C], float32; `controls` [B, C], float32.
    """
    told = [READINGS[each["kind"]](each, document, arrays, inputs, xp) for each in document["observation"]]
    outputs = computed(document["network"], arrays, xp.concat(told, axis=-1), xp, own)
    action = document["action"]
    if action["kind"] == "discrete":
        chosen = xp.argmax(outputs, axis=-1)
        return {
            "action": chosen,
            "action_value": outputs,
            "controls": controls_of(document, settings_of(document, arrays, chosen), inputs, xp),
        }
    chosen = xp.tanh(outputs[:, : len(document["controls"])])
    return {"action": chosen, "controls": controls_of(document, settings_of(document, arrays, chosen), inputs, xp)}


def settings_of(document: Document, arrays: Arrays, action: Values) -> Values:
    """The controls [B, C], each in -1..1, of actions."""
    if document["action"]["kind"] == "discrete":
        return arrays["action.settings"][action]
    low, high = arrays["action.ranges"][0], arrays["action.ranges"][1]
    return low + (high - low) * (action.clip(-1, 1) + 1) / 2


def controls_of(document: Document, settings: Values, inputs: Mapping[str, Values], xp: Any) -> Values:
    """The controls [B, C], each in its unit."""
    columns = []
    for index, control in enumerate(document["controls"]):
        low, middle, high = control["at"]
        share, limits = settings[:, index], control["steering_range"]
        value = middle + share.clip(min=0) * (high - middle) + share.clip(max=0) * (middle - low)
        if limits:
            speed = inputs["speed"]
            slowest = xp.full_like(speed, 1e-6)
            most = limits["lateral"] / xp.maximum(speed * speed, slowest) + limits["slip"]
            value = value * most.clip(limits["least"], limits["most"])
        columns.append(value)
    return xp.stack(columns, axis=-1)


def computed(layers: list[Document], arrays: Arrays, values: Values, xp: Any, own: Own = NONE) -> Values:
    """What layers make of values [B, ...]."""
    for layer in layers:
        if layer["kind"] == "dueling":
            advantage = computed(layer["advantage"], arrays, values, xp, own)
            value = computed(layer["value"], arrays, values, xp, own)
            values = value + advantage - xp.mean(advantage, axis=-1, keepdims=True)
        elif layer["kind"] == "own":
            values = own[layer["name"]](values)
        else:
            values = LAYERS[layer["kind"]](layer, arrays, values, xp)
    return values


def _linear(layer: Document, arrays: Arrays, values: Values, xp: Any) -> Values:
    return values @ arrays[layer["weight"]].T + arrays[layer["bias"]]


def _power(layer: Document, arrays: Arrays, values: Values, xp: Any) -> Values:
    return xp.sign(values) * xp.abs(values) ** layer["exponent"]


def _relu(layer: Document, arrays: Arrays, values: Values, xp: Any) -> Values:
    return values.clip(min=0)


def _tanh(layer: Document, arrays: Arrays, values: Values, xp: Any) -> Values:
    return xp.tanh(values)


def _elu(layer: Document, arrays: Arrays, values: Values, xp: Any) -> Values:
    return xp.where(values > 0, values, xp.expm1(values.clip(max=0)))


def _expectation(layer: Document, arrays: Arrays, values: Values, xp: Any) -> Values:
    """Of returns, by the logits of their probabilities: [B, K Z] to [B, K]."""
    support = arrays[layer["support"]]
    atoms = support.shape[0]
    logits = values.reshape(-1, values.shape[-1] // atoms, atoms)
    weights = xp.exp(logits - xp.amax(logits, axis=-1, keepdims=True))
    return (weights @ support) / xp.sum(weights, axis=-1)


LAYERS = {
    "linear": _linear,
    "power": _power,
    "relu": _relu,
    "tanh": _tanh,
    "elu": _elu,
    "expectation": _expectation,
}
"""What each kind of layer computes, beside `dueling`, of two lists of layers, and `own`."""


def _shares(ranges: Values, most: float, xp: Any) -> Values:
    """Distances as shares of the sensor's range; what is beyond, or not a number, is 1."""
    return xp.where(ranges < most, ranges.clip(min=0), xp.full_like(ranges, most)) / most


def _read_rays(reading: Document, document: Document, arrays: Arrays, inputs: Arrays, xp: Any) -> Values:
    newest = _shares(inputs["rays"], reading["max_range"], xp)
    if reading["count"] == 1:
        return newest
    earlier = _shares(inputs["previous_rays"][:, : reading["count"] - 1], reading["max_range"], xp)
    return xp.concat([newest, earlier.reshape(-1, earlier.shape[1] * earlier.shape[2])], axis=-1)


def _read_scaled(reading: Document, document: Document, arrays: Arrays, inputs: Arrays, xp: Any) -> Values:
    values = inputs[reading["input"]]
    values = values[:, None] if values.ndim == 1 else values
    return values / reading["divisor"] * reading["factor"]


def _read_velocity(reading: Document, document: Document, arrays: Arrays, inputs: Arrays, xp: Any) -> Values:
    speed, slip = inputs["speed"], inputs["slip"]
    return xp.stack([speed * xp.cos(slip), speed * xp.sin(slip)], axis=-1) / reading["divisor"]


def _read_one_hot(reading: Document, document: Document, arrays: Arrays, inputs: Arrays, xp: Any) -> Values:
    return arrays["action.one_hot"][inputs["last_action"]]


def _read_last_control(reading: Document, document: Document, arrays: Arrays, inputs: Arrays, xp: Any) -> Values:
    index = reading["index"]
    return settings_of(document, arrays, inputs["last_action"])[:, index : index + 1]


READINGS = {
    "rays": _read_rays,
    "scaled": _read_scaled,
    "velocity": _read_velocity,
    "one_hot": _read_one_hot,
    "last_control": _read_last_control,
}
"""What each kind of reading makes of the inputs, [B, some of O]."""
