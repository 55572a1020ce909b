#!/usr/bin/env bash
# Expected: torch.compile of an optimizer's step makes it faster. Adam's bias corrections, 1 minus
#   a power of beta by the number of the step, are two numbers for all weights, taken once a step.
# Happens: Inductor takes what is pointwise, also of one number, into the loops that use it. On a
#   CPU both powers stand in the loop over the weights, and are taken anew for each vector of them
#   (8 floats), by libm. With half a million weights the compiled step takes several times as long
#   as the uncompiled one with fused=True. In a functional Adam of one's own it is the same; there
#   it was 15 % of a whole compiled SAC update with two layers of 256.
# Versions: torch 2.13.0 (CPU), g++ 12.2, Python 3.11.
# Matters to: anyone who compiles an update with its optimizer for the CPU.
# Way out: let a reduction stand between, which Inductor writes to memory: expand the one number
#   to 16, take their power, and amax() of it.
set -euo pipefail
unset PYTHONPATH
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --disable-pip-version-check torch==2.13.0 numpy==2.4.6
cat > "$work/show.py" <<'PY'
import re
import time

import torch
from torch._inductor.utils import run_and_get_code

torch.set_num_threads(1)
print("torch", torch.__version__)


def adam(**options):
    torch.manual_seed(0)
    weights = [torch.nn.Parameter(torch.randn(512, 512)) for _ in range(2)]
    for each in weights:
        each.grad = torch.randn(512, 512)
    optimizer = torch.optim.Adam(weights, **options)
    optimizer.step()
    return optimizer.step


def milliseconds(step):
    best = float("inf")
    for _ in range(60):
        began = time.perf_counter()
        step()
        best = min(best, time.perf_counter() - began)
    return 1e3 * best


compiled, fused = torch.compile(adam(foreach=False)), adam(fused=True)
_, codes = run_and_get_code(compiled)
code = "\n".join(codes)
in_loops = [
    loop.count("std::pow") for loop in re.split(r"for\s*\(int64_t", code)[1:] if "Vectorized<float>::loadu" in loop
]
times = milliseconds(compiled), milliseconds(fused)
print(f"powers in each loop over the weights: {in_loops}")
print(f"a step of 524,288 weights: {times[0]:.2f} ms compiled, {times[1]:.2f} ms not compiled, fused")
same = bool(in_loops) and min(in_loops) >= 2 and times[0] > 1.5 * times[1]
print("still so" if same else "changed: powers are no longer taken in the loop, or cost nothing")
raise SystemExit(0 if same else 1)
PY
TORCHINDUCTOR_CACHE_DIR="$work/cache" "$work/venv/bin/python" "$work/show.py" 2> "$work/warnings"
