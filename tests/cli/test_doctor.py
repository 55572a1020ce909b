"""`carrl doctor`: what it finds of this machine, and what it says of others."""

import json
import tomllib
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import pytest

from carrl.cli import doctor
from carrl.cli.main import main


def findings(capsys, code=0):
    """By name, what `carrl doctor --json` prints."""
    assert main(["doctor", "--json"]) == code
    return {each["name"]: each for each in json.loads(capsys.readouterr().out)}


def test_all_that_carrl_needs_is_here(capsys):
    found = findings(capsys)
    assert {found[name]["state"] for name in ("python", "carrl", "packages", "torch")} == {"ok"}
    assert "torch 2." in found["packages"]["found"]
    assert all(bool(each["remedy"]) == (each["state"] != "ok") for each in found.values())


def test_every_extra_of_users_is_looked_at():
    extras = tomllib.loads(Path("pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert set(doctor.EXTRAS) == set(extras) - {"dev", "bench"}


def test_a_package_that_is_missing_or_too_old_is_named_with_what_to_install(monkeypatch, capsys):
    real = doctor.version

    def version(name):
        if name == "optuna":
            raise PackageNotFoundError(name)
        return "1.0.0" if name == "mcap" else real(name)

    monkeypatch.setattr(doctor, "version", version)
    found = findings(capsys, code=1)
    assert (found["mcap"]["state"], found["mcap"]["remedy"]) == ("broken", "pip install 'mcap>=1.6,<2'") or found[
        "mcap"
    ]["remedy"] == "pip install 'mcap<2,>=1.6'"
    assert (found["tune"]["state"], found["tune"]["remedy"]) == ("missing", "pip install 'carrl[tune]'")
    assert "packages" not in found


def test_what_carrl_can_do_without_is_no_failure(monkeypatch, capsys, tmp_path):
    (tmp_path / "no folder").touch()
    monkeypatch.setenv("CXX", "no-such-compiler")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "no folder"))
    for name in doctor.DISPLAYS:
        monkeypatch.delenv(name, raising=False)
    assert main(["doctor"]) == 0
    printed = capsys.readouterr().out
    for name in ("compiler", "cache", "display"):
        assert f"missing {name} " in printed
    assert "install g++" in printed


def test_a_compiler_that_compiles_nothing_is_no_compiler(monkeypatch, capsys, tmp_path):
    broken = tmp_path / "c++"
    broken.write_text("#!/bin/sh\necho 'trial.cpp: fatal error: omp.h: No such file' >&2\nexit 1\n")
    broken.chmod(0o755)
    monkeypatch.setenv("CXX", str(broken))
    assert findings(capsys)["compiler"]["found"] == (
        f"{broken} compiles nothing: trial.cpp: fatal error: omp.h: No such file"
    )


@pytest.mark.parametrize(
    ("version", "bounds", "fits"),
    [
        ("2.13.0+cpu", ">=2.13,<2.14", True),
        ("2.14.0", ">=2.13,<2.14", False),
        ("2.12.9", ">=2.13,<2.14", False),
        ("1.10", ">=1.6,<2", True),
        ("2.0", ">=1.6,<2", False),
        ("0.1", "", True),
    ],
)
def test_versions_are_compared_as_numbers(version, bounds, fits):
    assert doctor._fits(version, bounds) is fits
