"""Writes docs/configuration.md, every key of every YAML file in conf/: python scripts/configuration.py."""

import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
CONF = ROOT / "conf"
PAGE = ROOT / "docs" / "configuration.md"
HEADER = """# Configuration

Written by `python scripts/configuration.py` from the files in `conf/`; a test compares the two, so change those.

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

The reward and the observation are sums and rows of terms, each with keys of its own; a term set to `null` is left out:
`reward.gate.weight=20`, `reward.proximity=null`, `observation=rays_and_last_action`. `carrl.task.reward` and
`carrl.task.observation` have the terms, `carrl.task.action` what a car can choose among.

What each part of learning does to the first lap stands in [results.md](results.md#parts).

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
KEY = re.compile(r"(?P<indent> *)(?P<key>[\w/.]+):(?: +(?P<value>[^#]*?))?(?: +# (?P<comment>.*))?")


def page() -> str:
    """The whole page."""
    groups = sorted(path for path in CONF.iterdir() if path.is_dir())
    order = [line.split()[1].rstrip(":") for line in _lines(CONF / "train.yaml") if line.startswith("  - ")]
    groups.sort(key=lambda group: order.index(group.name) if group.name in order else len(order))
    defaults = dict(re.findall(r"^  - (\w+): (\w+)$", (CONF / "train.yaml").read_text(), flags=re.MULTILINE))
    parts = [HEADER, "## Top level\n", *_table(CONF / "train.yaml")]
    for group in groups:
        parts.append(f"\n## {group.name}\n")
        for path in sorted(group.glob("*.yaml"), key=lambda path: (path.stem != defaults.get(group.name), path.stem)):
            parts += _option(path, is_default=path.stem == defaults.get(group.name))
    return "\n".join(parts).rstrip() + "\n"


def _option(path: Path, is_default: bool) -> Iterator[str]:
    """One option of a group: what it is, what it is made of, its keys."""
    lines = _lines(path)
    yield f"### `{path.parent.name}={path.stem}`{', the default' if is_default else ''}\n"
    about = " ".join(line[2:] for line in lines if line.startswith("# ") and not line.startswith("# @package"))
    if about:
        yield f"{about.rstrip('.')}.\n"
    base = [line.split()[1] for line in lines if re.fullmatch(r"  - (?!_self_)\w+", line)]
    terms = [f"- `{name}`, built by `{target}`{comment}" for name, target, comment in _terms(path)]
    if base:
        yield f"As `{path.parent.name}={base[0]}`, {'with' if terms else 'but for'}:\n"
    chosen = re.findall(r"^  - override /(\w+)(?:@\S+)?: (\w+)", path.read_text(), flags=re.MULTILINE)
    if chosen:
        yield f"Picks {', '.join(f'`{group}={option}`' for group, option in chosen)}.\n"
    target = re.search(r"^ *_target_: (\S+)", path.read_text(), flags=re.MULTILINE)
    if target and not terms:
        yield f"Built by `{target[1]}`.\n"
    if terms:
        yield "\n".join(terms) + "\n"
    yield from _table(path)


def _terms(path: Path) -> Iterator[tuple[str, str, str]]:
    """What the terms of an observation or a reward are called and built by, and what is said of each."""
    found = re.findall(r"^(\w+):(?: +# (.*))?\n  _target_: (\S+)$", path.read_text(), flags=re.MULTILINE)
    for name, comment, target in found if "@package" not in path.read_text() else ():
        yield name, target, f": {comment}" if comment else ""


def _table(path: Path) -> list[str]:
    """The keys of a file as a table; none if there are none."""
    rows = [f"| `{key}` | `{value}` | {comment} |" for key, value, comment in _keys(path)]
    return ["| key | default | what it is |\n|---|---|---|", *rows, ""] if rows else []


def _keys(path: Path) -> Iterator[tuple[str, str, str]]:
    """Names, default values and comments of a file's keys; those of groups within a file by their full names."""
    above: list[str] = []
    for line in _lines(path):
        found = KEY.fullmatch(line)
        if found is None:
            continue
        above[len(found["indent"]) // 2 :] = [found["key"]]
        if found["value"] and above[0] not in ("defaults", "hydra") and not found["key"].startswith("_"):
            yield (
                ".".join(above),
                found["value"].strip().replace("|", "\\|"),
                (found["comment"] or "").replace("|", "\\|"),
            )


def _lines(path: Path) -> list[str]:
    return path.read_text().splitlines()


if __name__ == "__main__":
    PAGE.write_text(page())
