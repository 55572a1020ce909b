#!/usr/bin/env bash
# Expected: what TensorDict.memmap (or save) wrote comes back from load_memmap as it was, or
#   writing raises. NonTensorData holds any Python object, and pickle is there for what JSON
#   cannot say: a dict with int keys or a bytes value does come back unchanged.
# Happens: float("inf"), float("-inf") and float("nan") come back as None and tuples as lists.
#   Floats and tuples count as JSON, so they are not pickled; orjson, the default writer, has no
#   infinity and writes null. The object in memory stays right, consolidate() keeps the values,
#   and with set_json_backend("json") infinity and nan survive: two people with the same
#   TensorDict and another JSON writer get different files. An int beyond 64 bits, fine for
#   "json", makes orjson raise.
# Versions: tensordict 0.14.3, orjson 3.13.0, torch 2.13.0, Python 3.11.
# Matters to: settings and scores kept beside tensors in a saved TensorDict: best=-inf before the
#   first evaluation, max_norm=inf for "no clipping", bounds of a space, a missing lap time; and
#   sizes kept as tuples that are compared or used as keys. (A bare float assigned to a key
#   becomes a tensor and is safe; set_non_tensor and NonTensorData are not.)
# Way out: tensors for numbers, or set_json_backend("json") before saving and tuple(...) after.
set -euo pipefail
unset PYTHONPATH
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --disable-pip-version-check \
    torch==2.13.0 tensordict==0.14.3 orjson==3.13.0 numpy==2.4.6
cat > "$work/show.py" <<'PY'
import tempfile
from importlib.metadata import version

import torch
from tensordict import NonTensorData, TensorDict
from tensordict.utils import get_json_backend, set_json_backend

for package in ("tensordict", "orjson", "torch"):
    print(f"{package} {version(package)}")


def loaded(value):
    state = TensorDict({"weight": torch.zeros(2), "extra": NonTensorData(value)}, [])
    with tempfile.TemporaryDirectory() as folder:
        state.memmap(folder)
        return TensorDict.load_memmap(folder, allow_pickle=True)["extra"]


def show(value):
    back = loaded(value)
    print(f"  {value!r} -> {back!r}")
    return back


settings = {"best": float("-inf"), "max_norm": float("inf"), "hidden": (64, 64)}
print("default writer:", get_json_backend().__name__)
still = show(settings) == {"best": None, "max_norm": None, "hidden": [64, 64]}
still &= show(float("nan")) is None
still &= show((1, 2)) == [1, 2]
still &= show({1: (2, 3)}) == {1: (2, 3)}
in_memory = TensorDict({"extra": NonTensorData(settings)}, []).consolidate()["extra"]
still &= in_memory == settings
set_json_backend("json")
print("writer:", get_json_backend().__name__)
still &= show(settings) == {**settings, "hidden": [64, 64]}
print("still so: infinity comes back as None" if still else "CHANGED")
raise SystemExit(0 if still else 1)
PY
"$work/venv/bin/python" "$work/show.py"
