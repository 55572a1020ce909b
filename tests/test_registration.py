"""Gymnasium knows the environments, in whichever order the two are imported, and `import carrl` does not import it."""

import subprocess
import sys

import pytest

import carrl

MAKE = "print(gymnasium.make('carrl/Track-v0').spec.id, gymnasium.make_vec('carrl/Track-v0', num_envs=2).num_envs)"


@pytest.mark.parametrize(
    "imports",
    [
        "import carrl, gymnasium",
        "import gymnasium, carrl",
        "import carrl, carrl.log, gymnasium.envs",
        "import carrl, importlib.util; importlib.util.find_spec('gymnasium')",  # as TorchRL does
    ],
)
def test_gymnasium_makes_the_environments(imports):
    finished = subprocess.run(
        [sys.executable, "-c", f"{imports}\nimport gymnasium\n{MAKE}"], capture_output=True, text=True
    )
    assert finished.stdout == "carrl/Track-v0 2\n", finished.stderr


def test_importing_carrl_imports_neither_gymnasium_nor_torch():
    program = "import sys, carrl, carrl.log; print(sorted({'gymnasium', 'torch', 'tensordict'} & set(sys.modules)))"
    finished = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert finished.stdout == "[]\n", finished.stderr


def test_gymnasium_looks_as_if_nobody_had_watched_its_import():
    program = """
import sys
before = list(sys.meta_path)
import carrl, gymnasium
left = [finder for finder in sys.meta_path if finder not in before]
print([finder._module for finder in left], type(gymnasium.__spec__.loader).__name__)
"""
    finished = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert finished.stdout == "['torchrl.data.datasets.utils'] SourceFileLoader\n", finished.stderr


def test_the_package_lists_its_public_names_and_no_others():
    program = "import sys, carrl; print([n for n in dir(carrl) if n[:2] != '__'], 'torch' in sys.modules)"
    finished = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    names = [name for name in carrl.__all__ if not name.startswith("__")]
    assert finished.stdout == f"{sorted(names)} False\n", finished.stderr
