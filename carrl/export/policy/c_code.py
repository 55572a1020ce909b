"""The C code that computes a policy's outputs from its inputs; `carrl.export.policy.header` puts a header about it."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from carrl.export.policy.graph import Document

_IN_PLACE = {
    "power": "{v}[i] = {v}[i] < 0 ? -powf(-{v}[i], {exponent}) : powf({v}[i], {exponent});",
    "relu": "if ({v}[i] < 0) {v}[i] = 0.0f;",
    "tanh": "{v}[i] = tanhf({v}[i]);",
    "elu": "if ({v}[i] < 0) {v}[i] = expm1f({v}[i]);",
}
"""What layers do to each value; values that are not numbers stay so."""


class ActCode:
    """Writes the function `NAME_act`.

    Args:
        document: of the policy.
        arrays: of the policy.
        name: with which all names in C begin.
    """

    def __init__(self, document: Document, arrays: Mapping[str, np.ndarray], name: str) -> None:
        self._document, self._arrays, self._name = document, arrays, name
        self._inputs = {each["name"]: each for each in document["inputs"]}
        self._is_discrete = document["action"]["kind"] == "discrete"
        self._widths: list[int] = []

    def array(self, array: str) -> str:
        """The name in C of an array."""
        return f"{self._name}_{array.replace('.', '_')}"

    def helpers(self) -> Iterator[str]:
        """What the function calls."""
        name = self._name
        yield from (
            f"static inline float {name}_clip(float value, float least, float most)",
            "{",
            "    return value < least ? least : value > most ? most : value;",
            "}",
            "",
            "/* A distance as a share of the range; what is beyond, or not a number, is 1. */",
            f"static inline float {name}_share(float range, float most)",
            "{",
            "    return range < most ? (range > 0 ? range : 0.0f) / most : 1.0f;",
            "}",
            "",
            f"static inline void {name}_linear(const float *weight, const float *bias, int inputs, int outputs,",
            "                                 const float *from, float *to)",
            "{",
            "    for (int i = 0; i < outputs; i++) {",
            "        float sum = 0.0f;",
            "        for (int j = 0; j < inputs; j++) sum += weight[i * inputs + j] * from[j];",
            "        to[i] = sum + bias[i];",
            "    }",
            "}",
            "",
        )

    def lines(self) -> Iterator[str]:
        """The function itself."""
        told = list(self._observation())
        size = self._observation_size
        network = list(self._network(self._document["network"], "x", size))
        width = self._widths[-1]
        yield "/* Reads inputs, writes outputs, and keeps nothing. */"
        yield f"static inline void {self._name}_act(const {self._name}_inputs *inputs, {self._name}_outputs *outputs)"
        yield "{"
        yield f"    float x[{max([size, *self._widths])}], y[{max([size, *self._widths])}];"
        yield f"    float settings[{len(self._document['controls'])}];"
        yield "    int n = 0;"
        yield from told
        yield "    (void)n;"
        yield from network
        yield from self._discrete(width) if self._is_discrete else self._continuous()
        yield from self._physical()
        yield "}"
        yield ""

    @property
    def _observation_size(self) -> int:
        rays = self._document["sensor"]["rays"]
        widths = {"velocity": 2, "one_hot": len(self._document["actions"]), "last_control": 1}
        return sum(
            reading["count"] * rays
            if reading["kind"] == "rays"
            else int(np.prod(self._inputs[reading["input"]]["shape"]))
            if reading["kind"] == "scaled"
            else widths[reading["kind"]]
            for reading in self._document["observation"]
        )

    def _observation(self) -> Iterator[str]:
        name, rays = self._name, self._document["sensor"]["rays"]
        for reading in self._document["observation"]:
            kind = reading["kind"]
            if kind == "rays":
                most = number(reading["max_range"])
                yield f"    for (int i = 0; i < {rays}; i++) x[n++] = {name}_share(inputs->rays[i], {most});"
                if reading["count"] > 1:
                    yield f"    for (int s = 0; s < {reading['count'] - 1}; s++)"
                    yield f"        for (int i = 0; i < {rays}; i++)"
                    yield f"            x[n++] = {name}_share(inputs->previous_rays[s][i], {most});"
            elif kind == "scaled":
                way = f" / {number(reading['divisor'])} * {number(reading['factor'])};"
                given = self._inputs[reading["input"]]
                if given["shape"]:
                    yield f"    for (int i = 0; i < {given['shape'][0]}; i++) x[n++] = inputs->{given['name']}[i]{way}"
                else:
                    yield f"    x[n++] = inputs->{given['name']}{way}"
            elif kind == "velocity":
                for function in ("cosf", "sinf"):
                    yield f"    x[n++] = inputs->speed * {function}(inputs->slip) / {number(reading['divisor'])};"
            elif kind == "one_hot":
                count = len(self._document["actions"])
                yield f"    for (int i = 0; i < {count}; i++) x[n++] = inputs->last_action == i ? 1.0f : 0.0f;"
            else:
                yield from self._last_control(reading["index"])

    def _last_control(self, index: int) -> Iterator[str]:
        controls = len(self._document["controls"])
        if not self._is_discrete:
            yield f"    x[n++] = {self._ranged(f'inputs->last_action[{index}]', str(index))};"
            return
        table = self.array("action.settings")
        yield "    x[n] = 0.0f;"
        yield f"    for (int i = 0; i < {len(self._document['actions'])}; i++)"
        yield f"        if (inputs->last_action == i) x[n] = {table}[i * {controls} + {index}];"
        yield "    n++;"

    def _network(self, layers: list[Document], values: str, width: int) -> Iterator[str]:
        """Code that turns the values in one buffer into the outputs in the same one."""
        for layer in layers:
            kind = layer["kind"]
            if kind == "linear":
                weight, bias = self.array(layer["weight"]), self.array(layer["bias"])
                outputs, inputs = self._arrays[layer["weight"]].shape
                yield f"    {self._name}_linear({weight}, {bias}, {inputs}, {outputs}, {values}, y);"
                yield f"    for (int i = 0; i < {outputs}; i++) {values}[i] = y[i];"
                width = outputs
            elif kind == "expectation":
                yield from self._expectation(layer, values, width)
                width //= self._arrays[layer["support"]].size
            elif kind == "dueling":
                yield from self._dueling(layer, values, width)
                width = self._widths[-1]
            else:
                exponent = number(layer.get("exponent", 0.0))
                step = _IN_PLACE[kind].format(v=values, exponent=exponent)
                yield f"    for (int i = 0; i < {width}; i++) {{ {step} }}"
            self._widths.append(width)

    def _dueling(self, layer: Document, values: str, width: int) -> Iterator[str]:
        """Two streams, each in a buffer of its own: the value first, then the advantages in the buffer as it was."""
        first = len(self._widths)
        value = list(self._network(layer["value"], "v", width))
        widest = max([width, *self._widths[first:]])
        advantage = list(self._network(layer["advantage"], values, width))
        actions = self._widths[-1]
        yield f"    float v[{widest}], mean = 0.0f;"
        yield f"    for (int i = 0; i < {width}; i++) v[i] = {values}[i];"
        yield from value
        yield from advantage
        yield f"    for (int i = 0; i < {actions}; i++) mean += {values}[i] / {actions}.0f;"
        yield f"    for (int i = 0; i < {actions}; i++) {values}[i] = v[0] + {values}[i] - mean;"

    def _expectation(self, layer: Document, values: str, width: int) -> Iterator[str]:
        support = self.array(layer["support"])
        atoms = self._arrays[layer["support"]].size
        yield f"    for (int k = 0; k < {width // atoms}; k++) {{"
        yield f"        const float *logits = {values} + k * {atoms};"
        yield "        float most = logits[0], sum = 0.0f, mean = 0.0f;"
        yield f"        for (int i = 1; i < {atoms}; i++) if (logits[i] > most) most = logits[i];"
        yield f"        for (int i = 0; i < {atoms}; i++) {{"
        yield "            float weight = expf(logits[i] - most);"
        yield "            sum += weight;"
        yield f"            mean += weight * {support}[i];"
        yield "        }"
        yield "        y[k] = mean / sum;"
        yield "    }"
        yield f"    for (int k = 0; k < {width // atoms}; k++) {values}[k] = y[k];"

    def _discrete(self, actions: int) -> Iterator[str]:
        controls = len(self._document["controls"])
        yield "    outputs->action = 0;"
        yield f"    for (int i = 0; i < {actions}; i++) {{"
        yield "        outputs->action_value[i] = x[i];"
        yield "        if (x[i] > x[outputs->action]) outputs->action = i;"
        yield "    }"
        yield f"    for (int i = 0; i < {controls}; i++)"
        yield f"        settings[i] = {self.array('action.settings')}[outputs->action * {controls} + i];"

    def _continuous(self) -> Iterator[str]:
        yield f"    for (int i = 0; i < {len(self._document['controls'])}; i++) {{"
        yield "        outputs->action[i] = tanhf(x[i]);"
        yield f"        settings[i] = {self._ranged('outputs->action[i]', 'i')};"
        yield "    }"

    def _ranged(self, action: str, index: str) -> str:
        """A control within its range."""
        ranges, controls = self.array("action.ranges"), len(self._document["controls"])
        low, high = f"{ranges}[{index}]", f"{ranges}[{controls} + {index}]"
        return f"{low} + ({high} - {low}) * ({self._name}_clip({action}, -1.0f, 1.0f) + 1.0f) / 2.0f"

    def _physical(self) -> Iterator[str]:
        for index, control in enumerate(self._document["controls"]):
            low, middle, high = control["at"]
            share = f"settings[{index}]"
            up, down = number(high - middle), number(middle - low)
            value = f"{number(middle)} + {share} * ({share} > 0 ? {up} : {down})"
            limits: dict[str, Any] | None = control["steering_range"]
            if limits:
                lateral, slip, least, most = (number(limits[key]) for key in ("lateral", "slip", "least", "most"))
                square = f"{self._name}_clip(inputs->speed * inputs->speed, 1e-6f, INFINITY)"
                value = f"({value}) * {self._name}_clip({lateral} / {square} + {slip}, {least}, {most})"
            yield f"    outputs->controls[{index}] = {value}; /* {control['quantity']}, {control['unit']} */"


def number(value: float) -> str:
    """A float32 in C, the shortest decimal number that is the same."""
    return f"{np.float32(value)!s}f"


def numbers(values: Any) -> str:
    """Several of them."""
    return ", ".join(map(number, values))
