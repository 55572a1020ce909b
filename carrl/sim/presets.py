"""Parameters of cars for `carrl.sim.single_track`, by name.

`race` is the one to race with: low, with stiffer tyres behind than in front, so that it stays stable while it brakes,
and with tyres whose grip has a limit. The other two are CommonRoad's second car and that of F1TENTH, to compare with:
their tyres are linear, so that they corner at several times the grip that there is, and both spin when they brake.
"""

from collections.abc import Mapping

RACE: Mapping[str, str | float] = {
    "tyre": "brush",
    "steering": "angle",
    "pedals": "one",
    "contact": "body",
    "integrator": "rk4",
    "substep": 0.05,
    "length": 4.508,
    "width": 1.61,
    "mass": 1093.0,
    "yaw_inertia": 1792.0,
    "front_axle": 1.156,
    "rear_axle": 1.423,
    "height": 0.3,
    "friction": 1.0489,
    "front_stiffness": 20.9,
    "rear_stiffness": 1.3 * 20.9,
    "max_steering": 1.07,
    "steering_rate": 0.8,
    "max_acceleration": 11.5,
    "power_speed": 7.319,
    "max_speed": 50.8,
    "min_speed": 0.0,
    "slip_speed": 7.0,
    "kinematic_below": 6.0,
}
"""A single-seater of 1.1 t with 92 kW."""

COMMONROAD_2: Mapping[str, str | float] = {
    "tyre": "linear",
    "steering": "rate",
    "pedals": "one",
    "contact": "body",
    "integrator": "rk4",
    "substep": 0.05,
    "length": 4.508,
    "width": 1.61,
    "mass": 1093.2952334674046,
    "yaw_inertia": 1791.5995300122856,
    "front_axle": 1.1561957064,
    "rear_axle": 1.4227170936,
    "height": 0.61373004,
    "friction": 1.0489,
    "front_stiffness": 21.92 / 1.0489,
    "rear_stiffness": 21.92 / 1.0489,
    "max_steering": 1.066,
    "steering_rate": 0.4,
    "max_acceleration": 11.5,
    "power_speed": 7.319,
    "max_speed": 50.8,
    "min_speed": -13.9,
    "slip_speed": 7.0,
    "kinematic_below": 6.0,
}
"""The BMW 320i of `commonroad-vehicle-models` 3.0.2.

Source: Althoff and Wuersching, "CommonRoad: Vehicle Models" (2020), table 6, vehicle 2.
"""

F1TENTH: Mapping[str, str | float] = {
    "tyre": "linear",
    "steering": "servo",
    "pedals": "speed",
    "contact": "body",
    "integrator": "euler",
    "substep": 0.01,
    "length": 0.58,
    "width": 0.31,
    "mass": 3.74,
    "yaw_inertia": 0.04712,
    "front_axle": 0.15875,
    "rear_axle": 0.17145,
    "height": 0.074,
    "friction": 1.0489,
    "front_stiffness": 4.718,
    "rear_stiffness": 5.4562,
    "max_steering": 0.4189,
    "steering_rate": 3.2,
    "max_acceleration": 9.51,
    "power_speed": 7.319,
    "max_speed": 20.0,
    "min_speed": -5.0,
    "slip_speed": 1.5,
    "kinematic_below": 0.5,
}
"""The car of f1tenth_gym, of a tenth of the size.

Source: O'Kelly et al., "F1TENTH: An Open-source Evaluation Environment for Continuous Control and Reinforcement
Learning" (2020), and its simulator's default parameters.
"""

PRESETS: Mapping[str, Mapping[str, str | float]] = {"race": RACE, "commonroad_2": COMMONROAD_2, "f1tenth": F1TENTH}
