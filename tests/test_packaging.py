"""The wheel works from anywhere, and starts fast where no torch is needed."""

import os
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
import yaml
from packaging.specifiers import SpecifierSet

import carrl

ROOT = Path(carrl.__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def unpacked_wheel(tmp_path_factory):
    """The built wheel's contents, as an installer lays them out."""
    if not (ROOT / "pyproject.toml").is_file():
        pytest.skip("an installed CarRL has no project to build a wheel of")
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder), str(ROOT)]
    subprocess.run(build, check=True, capture_output=True)
    (wheel,) = folder.glob("carrl-*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder / "site")
    return folder / "site"


def run_installed(site, arguments, folder):
    environment = {**os.environ, "PYTHONPATH": str(site)}
    command = [sys.executable, "-m", "carrl.cli.main", *arguments]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=120)


def test_the_wheel_holds_every_configuration_file(unpacked_wheel):
    shipped = {str(path.relative_to(unpacked_wheel / "carrl")) for path in unpacked_wheel.rglob("*.yaml")}
    assert shipped == {str(path.relative_to(ROOT)) for path in (ROOT / "conf").rglob("*.yaml")}
    assert (unpacked_wheel / "carrl" / "py.typed").is_file()


def test_the_installed_wheel_trains_and_evaluates_from_an_empty_folder(unpacked_wheel, tmp_path):
    overrides = ["experiment=smoke", "compile=false", "trainer.frames=64", "replay_buffer.batch_size=16"]
    overrides += ["env.max_steps=50", "hydra.run.dir=outputs/run"]
    trained = run_installed(unpacked_wheel, ["train", *overrides], tmp_path)
    assert trained.returncode == 0, trained.stderr
    assert "results in" in trained.stdout
    evaluated = run_installed(unpacked_wheel, ["evaluate", "outputs/run", "--json"], tmp_path)
    assert evaluated.returncode == 0, evaluated.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["outputs"]


@pytest.mark.parametrize("module", ["carrl", "carrl.log", "carrl.cli.log", "carrl.cli.main"])
def test_reading_logs_needs_no_torch(module):
    code = f"import sys, {module}; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_the_public_names_are_all_there():
    assert all(getattr(carrl, name) is not None for name in carrl.__all__)
    with pytest.raises(AttributeError, match="no attribute 'Trak'"):
        carrl.Trak  # noqa: B018


def test_the_versions_of_python_that_are_named_are_those_that_ci_runs():
    if not (ROOT / ".github").is_dir():
        pytest.skip("an installed CarRL has no CI")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    jobs = yaml.safe_load((ROOT / ".github" / "workflows" / "ci.yml").read_text())["jobs"]
    tested = jobs["tests"]["strategy"]["matrix"]["python"]
    named = [entry.split(" :: ")[-1] for entry in project["classifiers"] if " :: Python :: 3." in entry]
    allowed = SpecifierSet(project["requires-python"])
    assert named == tested == [f"3.{minor}" for minor in range(30) if f"3.{minor}" in allowed]
    assert "Python {}, {} or {}".format(*tested) in (ROOT / "docs" / "quick-start.md").read_text()
