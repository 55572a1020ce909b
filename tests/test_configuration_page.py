"""docs/configuration.md says what the YAML files say."""

import importlib.util
import re
from pathlib import Path

import pytest
import yaml

from carrl.config import config_dir

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "configuration.md").read_text()
SECTIONS = dict(re.findall(r"^### `([\w/=]+)`.*?$(.*?)(?=^##|\Z)", PAGE, flags=re.MULTILINE | re.DOTALL))


def test_the_page_is_the_one_that_the_script_writes():
    spec = importlib.util.spec_from_file_location("configuration", ROOT / "scripts" / "configuration.py")
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    assert script.page() == PAGE, "run python scripts/configuration.py"


def values_of(node, prefix=""):
    for key, value in (node or {}).items():
        if key.startswith("_") or key == "defaults":
            continue
        if isinstance(value, dict):
            yield from values_of(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


@pytest.mark.parametrize(
    "path", sorted(config_dir().glob("*/*.yaml")), ids=lambda path: f"{path.parent.name}={path.stem}"
)
def test_every_key_of_every_file_is_on_the_page_with_its_value(path):
    section = SECTIONS[f"{path.parent.name}={path.stem}"]
    rows = dict(re.findall(r"^\| `([^`]+)` \| `([^`]+)` \|", section, flags=re.MULTILINE))
    found = dict(values_of({key: "???" if value == "???" else yaml.safe_load(value) for key, value in rows.items()}))
    assert found == dict(values_of(yaml.safe_load(path.read_text())))
