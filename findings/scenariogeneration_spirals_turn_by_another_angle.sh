#!/usr/bin/env bash
# Expected: xodr.Spiral(curvstart, curvend, angle=a) is the clothoid between these curvatures that
#   turns by a, as xodr.Arc(curvature, angle=a) is the arc that does; its documentation says
#   "Angle of the spiral", and asks for one of length, angle and cdot.
# Happens: the length is 2 |a| / max(|curvstart|, |curvend|), which is right only where one of the
#   two is 0. A clothoid turns by length (curvstart + curvend) / 2, so between two curves, where
#   neither is 0, the road turns by another angle, without a word: from 0.01 to 0.02 per metre
#   by 135 degrees instead of 90, from 0.02 to 0.02 by 180, from 0.02 to -0.01 by 45. All that
#   follows is laid on from there without a gap, so the file is valid, and the road goes elsewhere.
# Versions: scenariogeneration 0.16.7, NumPy 2.4.6, Python 3.11.
# Matters to: whoever makes roads for esmini, CARLA or other readers of OpenDRIVE by angles:
#   compound curves, S-curves without a straight between, circuits that are to come back to their
#   start. A sensor test on such a road runs on another bend than the one that was asked for.
# Way out: length=2 * a / (curvstart + curvend).
set -euo pipefail
unset PYTHONPATH
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --disable-pip-version-check scenariogeneration==0.16.7 numpy==2.4.6
cat > "$work/show.py" <<'PY'
import math
import xml.etree.ElementTree as ElementTree
from importlib.metadata import version

from scenariogeneration import xodr

for package in ("scenariogeneration", "numpy"):
    print(f"{package} {version(package)}")


def turned(piece):
    """By how much a written road turns in a piece between two lines, degrees: from the headings in its file."""
    road = xodr.create_road([xodr.Line(10), piece, xodr.Line(10)], id=1)
    network = xodr.OpenDrive("road")
    network.add_road(road)
    network.adjust_roads_and_lanes()
    network.write_xml("road.xodr")
    places = ElementTree.parse("road.xodr").getroot().findall("road/planView/geometry")
    return math.degrees(float(places[2].get("hdg")) - float(places[1].get("hdg"))) % 360


def show(asked, begin, end):
    found = turned(xodr.Spiral(begin, end, angle=math.radians(asked)))
    mended = turned(xodr.Spiral(begin, end, length=2 * math.radians(asked) / (begin + end)))
    print(f"  from {begin} to {end} per m: asked for {asked}, turned {found:.1f}; by length {mended:.1f}")
    assert abs(mended - asked) < 0.1
    return round(found, 1)


print("degrees that a road turns in Spiral(..., angle=...):")
print(f"  Arc(0.02, angle=90 degrees) turns {turned(xodr.Arc(0.02, angle=math.pi / 2)):.1f}")
still = show(90, 0.0, 0.02) == 90.0
still &= show(90, 0.01, 0.02) == 135.0
still &= show(90, 0.02, 0.01) == 135.0
still &= show(90, 0.02, 0.02) == 180.0
still &= show(90, 0.02, -0.01) == 45.0
print("still so: a spiral between two curves turns by another angle" if still else "CHANGED")
raise SystemExit(0 if still else 1)
PY
cd "$work"
"$work/venv/bin/python" "$work/show.py"
