#!/usr/bin/env bash
# Expected: a car that rolls backwards in a straight line, its wheels straight, goes on doing so. Tyres
#   dissipate whichever way they roll, so a disturbance of the yaw rate as small as rounding dies out.
# Happens: vehicle_dynamics_st divides by the signed speed where the slip angles are in question, so that
#   for v < -0.1 m/s the tyres' damping becomes its opposite. At -5 m/s without any command a yaw
#   rate of 1e-6 rad/s is 0.1 rad/s after 0.27 s and a million rad/s after 0.64 s; the slower, the faster.
#   At +5 m/s the same disturbance is gone after 0.4 s. The parameters allow -13.9 m/s, and the
#   function's only other case is the kinematic one within 0.1 m/s of standing.
# Versions: commonroad-vehicle-models 3.0.2, NumPy 2.4.6, Python 3.11.
# Matters to: whoever parks, reverses or lets a learner find the reverse gear with this model, with
#   CommonRoad's tools or with f1tenth_gym, whose single-track equations are the same. Planners diverge in
#   half a second, and a learner is paid for a spin that no car can make.
# Way out: |v| in the slip angles' denominators, or no reverse beyond the kinematic model.
set -euo pipefail
unset PYTHONPATH
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --disable-pip-version-check commonroad-vehicle-models==3.0.2 numpy==2.4.6
cat > "$work/show.py" <<'PY'
from importlib.metadata import version

import numpy as np
from vehiclemodels.parameters_vehicle2 import parameters_vehicle2
from vehiclemodels.vehicle_dynamics_st import vehicle_dynamics_st

for package in ("commonroad-vehicle-models", "numpy"):
    print(f"{package} {version(package)}")
car = parameters_vehicle2()
print(f"least speed of the car: {car.longitudinal.v_min} m/s")


def yaw_rate_after(seconds, speed, step):
    """Without any command, from a yaw rate of 1e-6 rad/s: classical Runge-Kutta, rad/s."""
    state = np.array([0.0, 0.0, 0.0, speed, 0.0, 1e-6, 0.0])  # x, y, steering, speed, heading, yaw rate, slip

    def slope(at):
        return np.array(vehicle_dynamics_st(list(at), [0.0, 0.0], car))

    for _ in range(round(seconds / step)):
        first = slope(state)
        second = slope(state + step / 2 * first)
        third = slope(state + step / 2 * second)
        fourth = slope(state + step * third)
        state = state + step / 6 * (first + 2 * second + 2 * third + fourth)
    return state[5]


print("yaw rate, 1e-6 rad/s at first, rad/s:")
found = {}
for speed in (5.0, 2.0, -2.0, -5.0):
    seconds = 0.4 if abs(speed) == 5 else 0.16
    coarse, fine = (yaw_rate_after(seconds, speed, step) for step in (1e-3, 5e-4))
    found[speed] = fine
    print(f"  at {speed:+.0f} m/s after {seconds} s: {fine:.3g} (with steps twice as long {coarse:.3g})")
still = all(abs(found[speed]) < 1e-6 for speed in (5.0, 2.0)) and all(found[speed] > 1 for speed in (-5.0, -2.0))
print("still so: in reverse a disturbance grows a million times" if still else "CHANGED")
raise SystemExit(0 if still else 1)
PY
"$work/venv/bin/python" "$work/show.py"
