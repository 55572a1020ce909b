"""The policy as one C header without dependencies, for a microcontroller."""

import json
import re
from collections.abc import Iterator
from pathlib import Path

from carrl.export.policy.c_code import ActCode, number, numbers
from carrl.export.policy.graph import Document, PolicyGraph

_TYPES = {"float32": "float", "int64": "int"}


def write_header(path: Path, graph: PolicyGraph, name: str) -> None:
    """Writes the header, whose names begin with `name`, in C99 that is C++ as well."""
    path.write_text(_Header(graph, name).text, encoding="ascii")


def identifier(stem: str) -> str:
    """A name in C for what a file is called."""
    name = re.sub(r"\W", "_", stem, flags=re.ASCII).lower()
    return name if name[:1].isalpha() else f"policy_{name}"


class _Header:
    """Writes a policy in C."""

    def __init__(self, graph: PolicyGraph, name: str) -> None:
        self._document, self._arrays, self._name = graph.document, graph.arrays, name
        self._inputs = {each["name"]: each for each in graph.document["inputs"]}
        self._is_discrete = graph.document["action"]["kind"] == "discrete"
        self._code = ActCode(graph.document, graph.arrays, name)

    @property
    def text(self) -> str:
        """All of the file."""
        name, upper, body = self._name, self._name.upper(), list(self._code.lines())
        return "\n".join(
            [
                *self._comment(),
                f"#ifndef {upper}_H",
                f"#define {upper}_H",
                "",
                "#include <math.h>",
                "",
                f"#define {upper}_CONTROL_PERIOD {number(self._document['control_period_s'])} /* s */",
                f"#define {upper}_RAYS {self._document['sensor']['rays']}",
                f"#define {upper}_MAX_RANGE {number(self._document['sensor']['max_range_m'])} /* m */",
                "#define "
                f"{upper}_RAY_ANGLES {{{numbers(self._document['sensor']['angles_rad'])}}} /* rad, from the heading */",
                *(f"#define {upper}_{_macro(each)} {index}" for index, each in enumerate(self._document["actions"])),
                "",
                "typedef struct {",
                *(_member(each) for each in self._document["inputs"]),
                f"}} {name}_inputs;",
                "",
                "typedef struct {",
                *(_member(each, self._controls) for each in self._document["outputs"]),
                f"}} {name}_outputs;",
                "",
                *self._constants(),
                "",
                *self._code.helpers(),
                *body,
                *self._start_and_next(),
                f"#endif /* {upper}_H */",
                "",
            ]
        )

    @property
    def _controls(self) -> str:
        return "; ".join(f"{each['name']}: {each['quantity']}, {each['unit']}" for each in self._document["controls"])

    def _comment(self) -> Iterator[str]:
        """What a reader wants to know, then the metadata."""
        name = self._name
        yield f"/* A driving policy exported by CarRL {_plain(self._document['carrl_version'])}."
        yield " * C99 without dependencies; needs no memory but the stack."
        yield " *"
        yield f" *     {name}_inputs inputs;"
        yield f" *     {name}_outputs outputs;"
        yield f" *     ... fill inputs by the sensors, then once: {name}_start(&inputs);"
        yield f" *     {name}_act(&inputs, &outputs);       -- the action and the controls"
        yield f" *     {name}_next(&inputs, &outputs);      -- before the next scan is written into inputs"
        yield " *"
        yield " * carrl-policy, in JSON:"
        document = json.dumps(self._document, ensure_ascii=True).replace("*/", "*\\/").replace("/*", "\\/*")
        yield document.replace("??", "?\\u003f")  # no trigraphs
        yield " */"

    def _constants(self) -> Iterator[str]:
        for array, values in self._arrays.items():
            if array == "action.one_hot":
                continue
            yield f"static const float {self._code.array(array)}[{values.size}] = {{"
            flat = values.ravel()
            for begin in range(0, flat.size, 8):
                yield f"    {numbers(flat[begin : begin + 8])},"
            yield "};"

    def _start_and_next(self) -> Iterator[str]:
        name = self._name
        yield "/* Once the first scan is in inputs: nothing has been done or seen before. */"
        yield f"static inline void {name}_start({name}_inputs *inputs)"
        yield "{"
        yield from self._acted("0" if self._is_discrete else "0.0f")
        if "previous_rays" in self._inputs:
            scans, rays = self._inputs["previous_rays"]["shape"]
            yield f"    for (int s = 0; s < {scans}; s++)"
            yield f"        for (int i = 0; i < {rays}; i++) inputs->previous_rays[s][i] = inputs->rays[i];"
        yield "    (void)inputs;"
        yield "}"
        yield ""
        yield "/* After each step, before the next scan is written into inputs: this one is the past now. */"
        yield f"static inline void {name}_next({name}_inputs *inputs, const {name}_outputs *outputs)"
        yield "{"
        yield from self._acted("outputs->action" if self._is_discrete else "outputs->action[i]")
        if "previous_rays" in self._inputs:
            scans, rays = self._inputs["previous_rays"]["shape"]
            yield f"    for (int s = {scans} - 1; s >= 0; s--)"
            yield f"        for (int i = 0; i < {rays}; i++)"
            yield "            inputs->previous_rays[s][i] = s ? inputs->previous_rays[s - 1][i] : inputs->rays[i];"
        yield "    (void)inputs;"
        yield "    (void)outputs;"
        yield "}"
        yield ""

    def _acted(self, action: str) -> Iterator[str]:
        """Code that remembers an action, if the policy asks for that."""
        if "last_action" not in self._inputs:
            return
        if self._is_discrete:
            yield f"    inputs->last_action = {action};"
        else:
            yield f"    for (int i = 0; i < {len(self._document['controls'])}; i++) inputs->last_action[i] = {action};"


def _member(each: Document, controls: str = "") -> str:
    sizes = "".join(f"[{size}]" for size in each["shape"])
    comment = controls if each["name"] == "controls" else f"{each['unit']}: {each['meaning']}"
    return f"    {_TYPES[each['dtype']]} {each['name']}{sizes}; /* {_plain(comment)} */"


def _plain(text: str) -> str:
    """Text that ends no comment."""
    return text.encode("ascii", "replace").decode().replace("*/", "* /").replace("\n", " ")


def _macro(action: str) -> str:
    return f"ACTION_{identifier(action).upper()}" if action else "ACTION"
