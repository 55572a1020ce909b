"""F1TENTH's car in plain numbers: linear single track, Euler's steps, a late servo, proportional speed control."""

import math
from dataclasses import dataclass, field

GRAVITY = 9.81


@dataclass(frozen=True)
class Parameters:
    mu: float = 1.0489
    c_f: float = 4.718
    c_r: float = 5.4562
    l_f: float = 0.15875
    l_r: float = 0.17145
    h: float = 0.074
    m: float = 3.74
    inertia: float = 0.04712
    s_max: float = 0.4189
    sv_max: float = 3.2
    v_switch: float = 7.319
    a_max: float = 9.51
    v_min: float = -5.0
    v_max: float = 20.0


COMMONROAD_1 = Parameters(
    c_f=21.92 / 1.0489,
    c_r=21.92 / 1.0489,
    l_f=0.3048 * 3.793293,
    l_r=0.3048 * 4.667707,
    h=0.3048 * 2.01355,
    m=4.4482216152605 / 0.3048 * 74.91452,
    inertia=4.4482216152605 * 0.3048 * 1321.416,
    s_max=1.066,
    sv_max=0.4,
    a_max=11.5,
    v_min=-13.6,
    v_max=50.8,
)


def limited(p, delta, v, rate, a):
    """Steering rate and acceleration that the car allows."""
    outwards = (delta <= -p.s_max and rate <= 0) or (delta >= p.s_max and rate >= 0)
    rate = 0.0 if outwards else min(max(rate, -p.sv_max), p.sv_max)
    strongest = p.a_max if v <= p.v_switch else p.a_max * p.v_switch / v
    at_limit = (v <= p.v_min and a <= 0) or (v >= p.v_max and a >= 0)
    return rate, 0.0 if at_limit else min(max(a, -p.a_max), strongest)


def derivative(p, state, rate, a, kinematic_below=0.5):
    """Of [x, y, steering angle, speed, heading, yaw rate, slip]."""
    _, _, delta, v, psi, r, beta = state
    rate, a = limited(p, delta, v, rate, a)
    length = p.l_f + p.l_r
    if abs(v) < kinematic_below:
        yaw = a / length * math.tan(delta) + v * rate / (length * math.cos(delta) ** 2)
        return [v * math.cos(psi), v * math.sin(psi), rate, a, v / length * math.tan(delta), yaw, 0.0]
    front, rear = GRAVITY * p.l_r - a * p.h, GRAVITY * p.l_f + a * p.h
    moment = p.l_f * p.c_f * front * delta
    moment += (p.l_r * p.c_r * rear - p.l_f * p.c_f * front) * beta
    moment -= (p.l_f**2 * p.c_f * front + p.l_r**2 * p.c_r * rear) * r / v
    aside = p.c_f * front * delta - (p.c_r * rear + p.c_f * front) * beta
    aside += (p.l_r * p.c_r * rear - p.l_f * p.c_f * front) * r / v
    return [
        v * math.cos(psi + beta),
        v * math.sin(psi + beta),
        rate,
        a,
        r,
        p.mu * p.m / (p.inertia * length) * moment,
        p.mu / (v * length) * aside - r,
    ]


@dataclass
class Car:
    """One car, driven by wanted steering angles, rad, and speeds, m/s."""

    parameters: Parameters = field(default_factory=Parameters)
    state: list = field(default_factory=lambda: [0.0] * 7)
    told: list = field(default_factory=lambda: [0.0, 0.0])

    def step(self, angle, speed, time=0.01):
        p, (_, _, delta, v, _, _, _) = self.parameters, self.state
        wanted = self.told.pop()
        self.told.insert(0, angle)
        ahead = wanted - delta
        rate = math.copysign(p.sv_max, ahead) if abs(ahead) > 1e-4 else 0.0
        missing = speed - v
        gain = (10.0 if v > 0 else 2.0) * p.a_max / (p.v_max if missing > 0 else -p.v_min)
        change = derivative(p, self.state, rate, gain * missing)
        self.state = [value + time * by for value, by in zip(self.state, change, strict=True)]
