"""`carrl doctor`: whether this installation has what CarRL needs, and what to install for what it could do besides."""

import argparse
import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Literal

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

import carrl
from carrl.cache import CacheError, cache_dir, own_cache_dir
from carrl.cli.parser import Parser
from carrl.errors import printable
from carrl.render.window import DISPLAYS

State = Literal["ok", "missing", "broken"]
"""Missing is what CarRL can do without; broken is what it needs."""
EXTRAS = {
    "render": "carrl drive and carrl watch, and windows of environments",
    "export": "videos, Rerun, Foxglove and Parquet",
    "racing": "carrl track lap-time, carrl evaluate --policy line and --limit auto",
    "onnx": "carrl export to ONNX, and driving with it",
    "tune": "carrl tune",
    "sweep": "carrl train -m on all cores, and on SLURM",
    "ray": "collector=ray",
    "tensorboard": "logger=tensorboard",
    "wandb": "logger=wandb",
    "mlflow": "logger=mlflow",
    "sb3": "Stable-Baselines3 on carrl/Track-v0",
    "pettingzoo": "carrl.parallel_env",
}
"""What each extra is for; those of pyproject.toml but for developers' own."""
_TIMEOUT_S = 30.0


@dataclass(frozen=True)
class Finding:
    """What was found of one thing.

    Attributes:
        name: of the thing.
        state: how it is.
        found: what there is, or why not.
        remedy: what to do about it; empty if it is well.
    """

    name: str
    state: State
    found: str
    remedy: str = ""


def main(argv: list[str]) -> int:
    """Prints a line for each thing, or one JSON document; the exit code is 1 if CarRL lacks what it needs."""
    arguments = _parser().parse_args(argv)
    findings = list(examine())
    if arguments.json:
        print(json.dumps([asdict(each) for each in findings], indent=2))
    else:
        width = max(len(each.name) for each in findings)
        for each in findings:
            print(printable(f"{each.state:<8}{each.name:<{width}}  {each.found}"))
            if each.remedy:
                print(printable(f"{'':<8}{'':<{width}}  -> {each.remedy}"))
    return int(any(each.state == "broken" for each in findings))


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="carrl doctor",
        description="Checks Python, packages, compiler, cache folder, display and extras, and says what to install. "
        "Exit code 1 if CarRL cannot work as it is.",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    return parser


def examine() -> Iterator[Finding]:
    """All findings, what CarRL needs first."""
    yield Finding("python", "ok", f"{platform.python_version()} in {sys.prefix}")
    yield Finding("carrl", "ok", f"{carrl.__version__} in {Path(carrl.__file__).parent}")
    yield from _needed_packages()
    yield _torch()
    yield _compiler()
    yield _cache()
    yield _display()
    yield _video()
    for extra, what in EXTRAS.items():
        yield _extra(extra, what)


def _requirements(extra: str | None = None) -> dict[str, str]:
    """The packages of an extra, or those that are always needed, each with the versions that will do."""
    wanted = [Requirement(line) for line in requires("carrl") or ()]
    return {
        each.name: str(each.specifier)
        for each in wanted
        if (each.marker is None and extra is None)
        or (each.marker is not None and extra is not None and each.marker.evaluate({"extra": extra}))
    }


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _fits(found: str, wanted: str) -> bool:
    """Whether a version is within bounds such as ">=2.13,<2.14"."""
    return SpecifierSet(wanted).contains(found, prereleases=True)


def _needed_packages() -> Iterator[Finding]:
    """Each needed package that is missing or of another version; one line where all is well."""
    try:
        wanted = _requirements()
    except PackageNotFoundError:
        yield Finding("packages", "broken", "carrl itself is not installed", "pip install -e . in its folder")
        return
    versions = {name: _version(name) for name in wanted}
    wrong = {name: found for name, found in versions.items() if found is None or not _fits(found, wanted[name])}
    for name, found in wrong.items():
        remedy = f"pip install '{name}{wanted[name]}'"
        yield Finding(name, "broken", f"{found or 'not installed'}; CarRL needs {wanted[name]}", remedy)
    shown = ("torch", "torchrl", "tensordict", "gymnasium", "hydra-core", "mcap", "numba", "numpy")
    those = ", ".join(f"{name} {versions[name]}" for name in shown if versions.get(name) and name not in wrong)
    if not wrong:
        yield Finding("packages", "ok", those)


def _torch() -> Finding:
    """Whether torch can be imported, and what it computes on."""
    try:
        import torch
    except (ImportError, OSError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        return Finding("torch", "broken", f"cannot be imported: {reason}", "pip install --force-reinstall torch")
    if torch.cuda.is_available():
        return Finding("torch", "ok", f"computes on {torch.cuda.get_device_name()} with device=cuda, and on the CPU")
    built = "built for CUDA, but no GPU is seen" if torch.version.cuda else "a CPU build"
    return Finding("torch", "ok", f"computes on the CPU, {os.cpu_count()} cores ({built})")


def _compiler() -> Finding:
    """Whether a C++ compiler compiles, with what updates need of it."""
    name = os.environ.get("CXX", "g++")
    remedy = (
        "install g++, such as apt install g++, or set CXX; until then updates of actors and critics, and of dueling, "
        "noisy and distributional networks, run eagerly, many times slower"
    )
    path = shutil.which(name)
    if path is None:
        return Finding("compiler", "missing", f"{name} is not installed", remedy)
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder, "trial.cpp")
        source.write_text("#include <cmath>\n#include <omp.h>\ndouble trial(double x) { return std::sqrt(x); }\n")
        command = [path, "-std=c++17", "-O1", "-fPIC", "-shared", "-fopenmp", str(source), "-o", f"{folder}/trial.so"]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False)
            told = subprocess.run([path, "--version"], capture_output=True, text=True, timeout=_TIMEOUT_S, check=False)
        except (OSError, subprocess.SubprocessError) as error:
            return Finding("compiler", "missing", f"{path} cannot be run: {error}", remedy)
    if done.returncode:
        why = next((line for line in done.stderr.splitlines() if "error" in line), "no reason given")
        return Finding("compiler", "missing", f"{path} compiles nothing: {why}", remedy)
    return Finding("compiler", "ok", f"{told.stdout.splitlines()[0] if told.stdout else path}")


def _cache() -> Finding:
    """Whether compiled updates and laps can be kept."""
    remedy = "until then each run compiles anew; XDG_CACHE_HOME names another place"
    try:
        folder = own_cache_dir()
        with tempfile.TemporaryFile(dir=folder):
            pass
    except (CacheError, OSError) as error:
        return Finding("cache", "missing", f"{cache_dir()}: {error}", remedy)
    kept = list(folder.rglob("*.pt2"))
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) / 2**20
    return Finding("cache", "ok", f"{folder}, {size:.0f} MiB, {len(kept)} compiled updates")


def _display() -> Finding:
    """Whether a window can be seen."""
    found = [f"{name}={os.environ[name]}" for name in DISPLAYS if name in os.environ]
    if found or sys.platform != "linux":
        return Finding("display", "ok", found[0] if found else "of the system")
    remedy = "carrl drive needs one, and carrl watch without --out FILE; everything else draws into files and pages"
    return Finding("display", "missing", f"none of {', '.join(DISPLAYS)} is set", remedy)


def _video() -> Finding:
    """Whether videos can be written; PyAV brings FFmpeg's libraries along."""
    own = _version("av")
    program = "ffmpeg, which CarRL does not use, " + ("is there" if shutil.which("ffmpeg") else "is absent")
    if own is None:
        return Finding("video", "missing", f"no PyAV, for .mp4 and .gif; {program}", "pip install 'carrl[export]'")
    return Finding("video", "ok", f"PyAV {own}, with FFmpeg's libraries; {program}")


def _extra(extra: str, what: str) -> Finding:
    """Whether all packages of an extra are there."""
    try:
        wanted = _requirements(extra)
    except PackageNotFoundError:
        wanted = {}
    versions = {name: _version(name) for name in wanted}
    lacking = [name for name, found in versions.items() if found is None or not _fits(found, wanted[name])]
    if lacking or not wanted:
        found = f"for {what}: no {', '.join(lacking or [extra])}"
        return Finding(extra, "missing", found, f"pip install 'carrl[{extra}]'")
    those = ", ".join(f"{name} {found}" for name, found in versions.items())
    return Finding(extra, "ok", f"for {what}: {those}")
