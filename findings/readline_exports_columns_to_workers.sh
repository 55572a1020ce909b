#!/usr/bin/env bash
# Expected: a test sees the same environment with `pytest` and with `pytest -n 1`; a process whose os.environ has no
#   COLUMNS starts children without it, so that what they print into a pipe is as wide as they were told to make it.
# Happens: pytest imports Python's readline, which is GNU readline, and that exports COLUMNS=80 and LINES=24 by itself,
#   into the C environment, not into os.environ of the process that did it: there it cannot be seen. Everything that is
#   started from then on has both, pytest-xdist's workers first of all, although there is no terminal anywhere.
#   shutil.get_terminal_size, argparse and rich take COLUMNS for the word of the user and fold at 80.
# Versions: pytest 9.2.0, pytest-xdist 3.8.0, Python 3.11 with GNU readline.
# Matters to: tests of what a command prints into a pipe: they pass alone and fail in parallel, or the other way round; and
#   any program that imports readline, as interactive consoles and debuggers do, and then starts others.
# Way out: remove both variables where children begin (a session fixture), or set them yourself.
set -euo pipefail
unset PYTHONPATH COLUMNS LINES
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --disable-pip-version-check pytest==9.2.0 pytest-xdist==3.8.0
cat > "$work/test_width.py" <<'PY'
import os
import shutil
from pathlib import Path


def test_width():
    width = shutil.get_terminal_size((160, 50)).columns
    Path(os.environ["SEEN"]).write_text(f"COLUMNS={os.environ.get('COLUMNS')} width={width}")
PY
cd "$work"
for workers in 0 1; do
    SEEN="$work/seen$workers" "$work/venv/bin/python" -m pytest -q -n $workers test_width.py > "$work/output" < /dev/null 2>&1 \
        || { cat "$work/output"; exit 1; }
    echo "pytest -n $workers: $(cat "$work/seen$workers")"
done
"$work/venv/bin/python" - <<'PY'
import os
import readline
import subprocess
import sys

child = subprocess.run([sys.executable, "-c", "import os; print(os.environ.get('COLUMNS'))"], capture_output=True, text=True)
print(f"after import readline: here {os.environ.get('COLUMNS')}, in a child {child.stdout.strip()}")
sys.exit(child.stdout.strip() != "80" or "COLUMNS" in os.environ)
PY
[[ $(cat "$work/seen0") == "COLUMNS=None width=160" && $(cat "$work/seen1") == "COLUMNS=80 width=80" ]]
