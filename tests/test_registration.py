"""Gymnasium knows the environments, in whichever order the two are imported, and `import carrl` does not import it."""

import subprocess
import sys

import pytest

import carrl

FIND = "import gymnasium; print(gymnasium.spec('carrl/Track-v0').id)"
MAKE = "import gymnasium; print(gymnasium.make('carrl/Track-v0').spec.id)"


def printed_by(program):
    finished = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    return finished.stdout or finished.stderr


@pytest.mark.parametrize(
    "imports",
    [
        "import carrl, gymnasium",
        "import gymnasium, carrl",
        "import carrl, carrl.log, gymnasium.envs",
        "import carrl, importlib.util; importlib.util.find_spec('gymnasium')",  # as TorchRL does
    ],
)
def test_gymnasium_finds_the_environments(imports):
    assert printed_by(f"{imports}\n{FIND}") == "carrl/Track-v0\n"


def test_gymnasium_makes_an_environment_in_a_new_process():
    assert printed_by(f"import gymnasium, carrl\n{MAKE}") == "carrl/Track-v0\n"


def test_importing_carrl_imports_neither_gymnasium_nor_torch():
    program = "import sys, carrl, carrl.log; print(sorted({'gymnasium', 'torch', 'tensordict'} & set(sys.modules)))"
    assert printed_by(program) == "[]\n"


def test_gymnasium_looks_as_if_nobody_had_watched_its_import():
    program = """
import sys
before = list(sys.meta_path)
import carrl, gymnasium
left = [finder for finder in sys.meta_path if finder not in before]
print([finder._module for finder in left], type(gymnasium.__spec__.loader).__name__)
"""
    assert printed_by(program) == "['torchrl.data.datasets.utils'] SourceFileLoader\n"


def test_the_package_lists_its_public_names_and_no_others():
    program = "import sys, carrl; print([n for n in dir(carrl) if n[:2] != '__'], 'torch' in sys.modules)"
    names = [name for name in carrl.__all__ if not name.startswith("__")]
    assert printed_by(program) == f"{sorted(names)} False\n"
