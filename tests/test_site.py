"""The documentation site's sources; scripts/docs, which CI runs, builds it and fails on a broken link."""

import re
from pathlib import Path

import carrl

ROOT = Path(__file__).resolve().parents[1]
ELSEWHERE = {
    "train": "carrl.train.run.train",
    "sb3": "carrl.sb3.make_vec_env",
    "parallel_env": "carrl.env.parallel_env.parallel_env",
}
"""Where a public name is described that is a module and more."""


def test_the_api_reference_has_every_public_name():
    described = re.findall(r"^::: (\S+)", (ROOT / "docs" / "api.md").read_text(), re.M)
    assert sorted(described) == sorted(ELSEWHERE.get(name, f"carrl.{name}") for name in carrl.__all__)


def test_the_readme_is_one_page():
    assert len((ROOT / "README.md").read_text().split()) < 700


def test_the_moving_picture_is_small_enough_for_a_page():
    assert (ROOT / "docs" / "images" / "spa.gif").stat().st_size < 2_000_000
