#!/usr/bin/env bash
# Expected: a field that a structured config declares as `str` gets the characters typed after
#   `key=`: commit=8958e61 is "8958e61", release=1.10 is "1.10".
# Happens: the override grammar decides first, without the schema: what looks like a number is
#   one. Only then does OmegaConf turn the number into a text for the `str` field, in Python's
#   spelling: "8.958e+64" and "1.1", 12e4567 becomes "inf", 1_000 becomes "1000", true "True".
#   No error, because the field holds a text as declared. Numbers with leading zeros (007)
#   and most hexadecimal hashes stay, so it is seen only now and then: of random seven-digit
#   short hashes about 1.9 % are digits with one e inside.
# Versions: hydra-core 1.3.8, omegaconf 2.3.1, Python 3.11.
# Matters to: runs that are handed a git commit, a version or a file stem on the command line;
#   the run folder and its log then name a commit that does not exist.
# Way out: quote for Hydra as well as for the shell: 'commit="8958e61"'.
set -euo pipefail
unset PYTHONPATH
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --disable-pip-version-check hydra-core==1.3.8 omegaconf==2.3.1
cat > "$work/show.py" <<'PY'
import random
import re
from dataclasses import dataclass
from importlib.metadata import version

from hydra import compose, initialize
from hydra.core.config_store import ConfigStore

print(f"hydra-core {version('hydra-core')}, omegaconf {version('omegaconf')}")


@dataclass
class Run:
    commit: str = "none"


ConfigStore.instance().store(name="run", node=Run)


def composed(typed):
    return compose("run", [f"commit={typed}"]).commit


rewritten = {"8958e61": "8.958e+64", "12e4567": "inf", "1.10": "1.1", "1_000": "1000", "true": "True"}
kept = ("007", "a958e61", "1.10.0", '"8958e61"')
with initialize(version_base="1.3", config_path=None):
    still = True
    for typed, stored in rewritten.items():
        print(f"commit={typed:10s} -> {composed(typed)!r}")
        still &= composed(typed) == stored
    for typed in kept:
        print(f"commit={typed:10s} -> {composed(typed)!r} (kept)")
        still &= composed(typed) == typed.strip('"')
    digits = random.Random(0)
    hashes = [f"{digits.randrange(16**7):07x}" for _ in range(2_000)]
    numbers = [typed for typed in hashes if re.fullmatch(r"[0-9]+e[0-9]+", typed)]
    changed = [typed for typed in numbers if composed(typed) != typed]
print(f"{len(changed)} of {len(hashes)} random short hashes changed, e.g. "
      + ", ".join(changed[:3]))
still &= len(changed) > 20
print("still so: a str field is rewritten" if still else "CHANGED")
raise SystemExit(0 if still else 1)
PY
"$work/venv/bin/python" "$work/show.py"
