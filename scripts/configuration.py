"""Writes docs/configuration.md, from conf/ and the docstrings of what it builds: python scripts/configuration.py."""

import inspect
import pkgutil
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from carrl.config import TARGETS
from carrl.train.composition import PLAIN_KEYS

ROOT = Path(__file__).resolve().parents[1]
CONF = ROOT / "conf"
PAGE = ROOT / "docs" / "configuration.md"
HEADER = """# Configuration

Written by `python scripts/configuration.py` from the files in `conf/` and from the docstrings of what they build; a test
compares them, so change those.

`carrl train GROUP=OPTION` picks an option of a group, `carrl train GROUP.KEY=VALUE` changes a value of the option that is
picked, and `-m` with commas between options or values sweeps over them. An experiment is a set of such choices, and what is
typed beside it counts; `--config-dir FOLDER` adds a folder with experiments and options of your own. Nothing that is typed, or
stands in such a file, is ignored: a key, option or flag that there is not, a setting without effect, a value of a wrong type or out
of range, and parts that do not go together each end in one sentence, with what may have been meant, and exit code 2, before training.

```console
$ carrl train loss=double_dqn target_updater=soft target_updater.tau=0.01
$ carrl train -m experiment=fast loss=dqn,double_dqn,dueling,distributional
$ carrl train -m experiment=fast returns.steps=1,3 replay_buffer=uniform,prioritized trainer.seeds=[0..9]
```

The reward, the observation and the end of an episode are sums, rows and sets of terms, each with keys of its own; a term set
to `null` is left out: `reward.gate.weight=20`, `reward.proximity=null`, `observation=rays_and_last_action`. `carrl.task` has the
terms: rewards in `reward` and `racing`, observations in `observation`, `motion` and `road`, ends in `end`, and in `action` what a
car can choose among.

A `_target_` that you type, or that stands in your own files, may be any class or function that can be imported;
`examples/own_parts` has a vehicle, an observation, a reward, a network, a loss and a track format.

What each part of learning does to the first lap stands in [The paper's track](experiments/paper-track.md#parts).

## What does not go together

| | because |
|---|---|
| `network=distributional` and another loss than `loss=distributional`, or the other way round | the loss needs the probabilities of returns, and other losses their mean; `loss=distributional` picks the network |
| `loss=dueling` and another network than `network=dueling` | `loss=dueling` picks it, and is Double DQN otherwise |
| `loss=cql` and `replay_buffer=prioritized` | the conservative term weighs all transitions alike |
| `data=log` and `returns.steps=3` | a log may hold every other episode or car only, and not the steps between |

Everything else goes together, several agents (`trainer.seeds`) and `resume=RUN` included. `network=noisy` explores by itself,
so that `exploration=constant exploration.epsilon=0` is its usual companion, but it need not be.
"""  # noqa: E501 (a table's row is one line)
OPTIMIZER = {
    "lr": "learning rate (Table I)",
    "fused": "one kernel for all parameters; the same numbers, less overhead",
}
"""Of torch's Adam, whose docstring is not ours."""


def page() -> str:
    """The whole page."""
    train = yaml.safe_load((CONF / "train.yaml").read_text())
    chosen = {
        group: option for each in train.pop("defaults") if isinstance(each, dict) for group, option in each.items()
    }
    train.pop("hydra")
    plain = {key: value for key, value in train.items() if key in PLAIN_KEYS}
    parts = [HEADER, "## Top level\n", *_table(_row(key, value, PLAIN_KEYS[key]) for key, value in plain.items())]
    parts += ["## Settings of parts without a choice\n"]
    for name, node in train.items():
        if name not in plain:
            parts += [f"### `{name}`\n", *_node(name, node, TARGETS[name][0])]
    for group in (group for group in chosen if (CONF / group).is_dir()):
        parts.append(f"## {group}\n")
        paths = sorted((CONF / group).glob("*.yaml"), key=lambda path: (path.stem != chosen[group], path.stem))
        for path in paths:
            parts += _option(path, is_default=path.stem == chosen[group])
    return "\n".join(parts).rstrip() + "\n"


def _option(path: Path, is_default: bool) -> Iterator[str]:
    """One option of a group: what it is, what it is made of, its keys."""
    group, text = path.parent.name, path.read_text()
    yield f"### `{group}={path.stem}`{', the default' if is_default else ''}\n"
    about = " ".join(line[2:] for line in text.splitlines() if line.startswith("# ") and "@package" not in line)
    if about:
        yield f"{about.rstrip('.')}.\n"
    content: dict[str, Any] = yaml.safe_load(text) or {}
    defaults = [each for each in content.pop("defaults", ()) if each != "_self_"]
    picked = [
        f"`{key.split('@')[0].removeprefix('override /')}={each[key]}`"
        for each in defaults
        if isinstance(each, dict)
        for key in each
    ]
    base = [each for each in defaults if isinstance(each, str)]
    if base:
        yield f"As `{group}={base[0]}`, but for:\n"
    if picked:
        yield f"Picks {', '.join(picked)}.\n"
    if "@package _global_" in text:
        yield from _table(_row(key, value, "") for key, value in _leaves(content))
        own = content.get(group)
        if isinstance(own, dict) and "_target_" in own:
            yield from _node(group, own, own["_target_"])
    elif content and all(isinstance(value, dict) and "_target_" in value for value in content.values()):
        for name, node in content.items():
            yield from _node(name, node, node["_target_"], of_term=True)
    elif content:
        yield from _node(group, content, content.get("_target_") or _target_of(path.parent, base))


def _target_of(group: Path, base: list[str]) -> str:
    """What the option builds on which another is based."""
    content = yaml.safe_load((group / f"{base[0]}.yaml").read_text())
    further = [each for each in content.get("defaults", ()) if each != "_self_" and isinstance(each, str)]
    return str(content.get("_target_") or _target_of(group, further))


def _node(name: str, node: Mapping[str, Any], target: str, of_term: bool = False) -> Iterator[str]:
    """What a node of the configuration builds, and its keys."""
    part = pkgutil.resolve_name(target)
    first = (inspect.getdoc(part) or "").split("\n\n")[0].replace("\n", " ")
    built = f"`{name}`, built by `{target}`" if of_term else f"Built by `{target}`"
    yield (
        f"{built}: {first[:1].lower() if of_term else first[:1]}{first[1:]}\n"
        if target.startswith("carrl.")
        else f"{built}.\n"
    )
    described = described_parameters(part) if target.startswith("carrl.") else OPTIMIZER
    values = {key: value for key, value in node.items() if key != "_target_"}
    yield from _table(_row(key, value, described[key]) for key, value in values.items())


def described_parameters(part: Any) -> dict[str, str]:
    """What the docstring of a class or function says of each parameter."""
    found: dict[str, str] = {}
    section = re.search(
        r"^(?:Args|Attributes):\n(.*?)(?=^\S|\Z)", inspect.getdoc(part) or "", flags=re.DOTALL | re.MULTILINE
    )
    for entry in re.finditer(
        r"^    (\w+): (.*?)(?=^    \S|\Z)", section[1] if section else "", flags=re.DOTALL | re.MULTILINE
    ):
        found[entry[1]] = " ".join(entry[2].split()).rstrip(".")
    return found


def _leaves(content: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """The values of an experiment by their full keys."""
    for key, value in content.items():
        if isinstance(value, dict) and value:
            if "_target_" not in value:
                yield from _leaves(value, f"{above}{key}.")
        else:
            yield f"{above}{key}", value


def _row(key: str, value: Any, about: str) -> str:
    shown = yaml.safe_dump(value, default_flow_style=True, width=1000).strip().removesuffix("...").strip()
    return f"| `{key}` | `{shown}` | {about} |".replace("|TD error|", "\\|TD error\\|")


def _table(rows: Iterator[str]) -> list[str]:
    """Keys as a table; nothing if there are none."""
    found = list(rows)
    return ["| key | default | what it is |\n|---|---|---|", *found, ""] if found else []


if __name__ == "__main__":
    PAGE.write_text(page())
