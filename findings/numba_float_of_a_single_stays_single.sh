#!/usr/bin/env bash
# Expected: float(x) of a float32 is a double, as in Python, where float(np.float32(1)) + 1e-9 is more
#   than 1: the usual way to go on in double precision with data that is stored in single.
# Happens: in a function that Numba compiles float(x) of a float32 remains a float32. Sums, products and
#   calls of math on such values are in single precision, though each is written as float(...). The
#   result is a Python float again, so nothing shows: 1 + 1e-9 is 1, and the sine of 1e5 rad is
#   off in the third digit after its sum with 0.01 was rounded. Beside a double, as a literal, it is promoted,
#   so some expressions of a function are in double precision and others are not. np.float64(x) does what float does in Python.
# Versions: Numba 0.68.1, NumPy 2.4.6, Python 3.11.
# Matters to: whoever moves a simulator's or filter's inner loop to Numba and keeps its state in float32, as
#   learners want it: the compiled code is less exact than the Python that it came from, and steps of an
#   integrator that are small beside the state are lost.
# Way out: np.float64(x).
set -euo pipefail
unset PYTHONPATH
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --disable-pip-version-check numba==0.68.1 numpy==2.4.6
cat > "$work/show.py" <<'PY'
import math
from importlib.metadata import version

import numba
import numpy as np

for package in ("numba", "numpy"):
    print(f"{package} {version(package)}")


def total(values):
    first, second = float(values[0]), float(values[1])
    return first + second


def sine(values):
    return math.sin(float(values[0]) + float(values[1]))


def explicit(values):
    return np.float64(values[0]) + np.float64(values[1])


def beside_a_double(values):
    return float(values[0]) + 1e-9


small, large = np.array([1, 1e-9], np.float32), np.array([1e5, 0.01], np.float32)
rows = {}
for name, function, values in (
    ("float(1) + float(1e-9) - 1", total, small),
    ("np.float64(1) + np.float64(1e-9) - 1", explicit, small),
    ("float(1) + 1e-9 - 1", beside_a_double, small),
    ("sin(float(100000) + float(0.01))", sine, large),
):
    less = 0 if function is sine else 1
    rows[name] = plain, fast = function(values) - less, numba.njit(function)(values) - less
    print(f"  {name}: Python {plain:.9g}, Numba {fast:.9g}")
first, second, third, fourth = rows.values()
still = first[1] == 0 and abs(first[0] - 1e-9) < 1e-15
still &= abs(second[1] - 1e-9) < 1e-15 and abs(third[1] - 1e-9) < 1e-15
still &= abs(fourth[0] - fourth[1]) > 1e-4
print("still so: float() does not widen a float32" if still else "CHANGED")
raise SystemExit(0 if still else 1)
PY
"$work/venv/bin/python" "$work/show.py"
