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


@pytest.mark.parametrize(
    "path", sorted(config_dir().glob("*/*.yaml")), ids=lambda path: f"{path.parent.name}={path.stem}"
)
def test_every_key_of_every_file_is_on_the_page(path):
    section = SECTIONS[f"{path.parent.name}={path.stem}"]
    for key in keys_of(yaml.safe_load(path.read_text())):
        names = [key, key.partition(".")[2], key.partition(".")[0]]  # in full, a term's own, or one of a mapping
        assert any(f"`{name}`" in section for name in names)


def keys_of(node, prefix=""):
    for key, value in (node or {}).items():
        if isinstance(value, dict):
            yield from keys_of(value, f"{prefix}{key}.")
        elif not key.startswith("_") and key != "defaults":
            yield f"{prefix}{key}"


def test_every_setting_has_a_description():
    described = yaml.safe_load((config_dir() / "train.yaml").read_text()).keys() - {"defaults", "hydra"}
    for row in re.findall(r"^\| `(\w+)` \| `[^`]+` \| (.*) \|$", PAGE, flags=re.MULTILINE):
        assert row[1] or row[0] in described, row
