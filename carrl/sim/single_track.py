"""The single-track model: a car on two axles, whose tyres slip.

Shapes: `N` cars, `S` entries of the state, `C` controls. Units: m, s, rad; angles counter-clockwise and to the left
positive.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from carrl.errors import ConfigError, shown
from carrl.sim.driven import GRAVITY, LEAST_RANGE, MOTION, PEDALS, RANGE_LATERAL, RANGE_SLIP, DrivenCar
from carrl.sim.presets import PRESETS
from carrl.sim.tyres import EASE, FULL_SLIP, MOST_SPIN, REST, STEERABLE, TYRES
from carrl.sim.vehicle import MOST, Kernel, Rectangle

if TYPE_CHECKING:
    Number = float
    Word = str
else:  # That they may be left to the preset is nobody's business once it has filled them in.
    Number = float | None
    Word = str | None

STEERING = "angle", "rate", "servo"
_PEDALS = {**PEDALS, "speed": ("speed",), "power": ("pedal",)}
"""Names of the controls beside the steering wheel."""
COMMANDS = "steer_command", "earlier_steer_command"
"""What the servo has been told in the last two substeps, the last first, -1..1."""
SERVO_DEAD_BAND = 1e-4
"""rad; F1TENTH's servo turns at its full rate unless it is this near."""
FORWARD_GAIN, BACKWARD_GAIN = 10.0, 2.0
"""Of F1TENTH's speed control, in max_acceleration / max_speed, for cars that drive forward or backward."""
_OF_PRESET: Any = None


@dataclass(frozen=True)
class SingleTrack(DrivenCar):
    """A car with tyres that slip, load that moves, and an engine and brakes as strong as they are.

    Every parameter that is None is the preset's.

    Attributes:
        preset: whose parameters those are that are not given: `race`, `commonroad_2` or `f1tenth`.
        time_step: simulated time of one step, s.
        tyre: `brush`: grip has a limit, which braking and cornering share; `linear`: it has none, as in CommonRoad.
        steering: `angle`: the control is a share of the steering range, which narrows with the speed, and the wheels
            turn there as fast as they can; `rate`: a share of how fast they turn; `servo`: F1TENTH's, a share of
            `max_steering`, with a delay of two substeps.
        pedals: `one`: drives where it is positive, brakes where it is negative; `two`: throttle and brake, each
            released at -1 and down at 1; `power`: as `one`, but above 0 it is a share of what the engine gives at this
            speed, so that no part of its way is without effect; `speed`: F1TENTH's, a share of `max_speed`, or of
            `min_speed` below 0.
        contact: `body`: any part of it that touches a wall on the way; `corners`: one of its corners that is beyond a
            wall after a step, as in the F1TENTH survey of Evans et al. 2024.
        integrator: `rk4` or `euler`; always `rk4` with brush tyres.
        substep: the longest step of the integrator, s; a time step is divided into equal ones.
        length: of the body, about the centre of gravity, m.
        width: of the body, m.
        mass: kg.
        yaw_inertia: about the vertical axis, kg m^2.
        front_axle: from the centre of gravity to the front axle, m.
        rear_axle: to the rear axle, m.
        height: of the centre of gravity, m; it moves load between the axles.
        friction: greatest force of a tyre, in multiples of its load.
        front_stiffness: lateral force by slip angle, in multiples of friction * load, 1/rad.
        rear_stiffness: the same behind.
        max_steering: how far the front wheels turn to either side, rad.
        steering_rate: how fast they turn at most, rad/s.
        max_acceleration: of engine and of brakes, m/s^2; brush tyres may not hold it.
        power_speed: from this speed on the engine is at full power, and gives less acceleration, m/s.
        max_speed: m/s.
        min_speed: m/s; 0 for a car without a reverse gear, less for one that drives backwards so fast.
        slip_speed: the least speed that the slip of brush tyres is taken against, m/s.
        kinematic_below: the speed below which a car with linear tyres rolls where its wheels point, m/s.
    """

    preset: str = "race"
    time_step: float = 0.1
    tyre: Word = _OF_PRESET
    steering: Word = _OF_PRESET
    pedals: Word = _OF_PRESET
    contact: Word = _OF_PRESET
    integrator: Word = _OF_PRESET
    substep: Number = _OF_PRESET
    length: Number = _OF_PRESET
    width: Number = _OF_PRESET
    mass: Number = _OF_PRESET
    yaw_inertia: Number = _OF_PRESET
    front_axle: Number = _OF_PRESET
    rear_axle: Number = _OF_PRESET
    height: Number = _OF_PRESET
    friction: Number = _OF_PRESET
    front_stiffness: Number = _OF_PRESET
    rear_stiffness: Number = _OF_PRESET
    max_steering: Number = _OF_PRESET
    steering_rate: Number = _OF_PRESET
    max_acceleration: Number = _OF_PRESET
    power_speed: Number = _OF_PRESET
    max_speed: Number = _OF_PRESET
    min_speed: Number = _OF_PRESET
    slip_speed: Number = _OF_PRESET
    kinematic_below: Number = _OF_PRESET

    choices = {  # noqa: RUF012 (nobody changes it)
        "preset": PRESETS,
        "tyre": TYRES,
        "steering": STEERING,
        "pedals": _PEDALS,
        "contact": ("body", "corners"),
        "integrator": ("rk4", "euler"),
    }

    def __post_init__(self) -> None:
        """Takes from the preset what was not given.

        Raises:
            ConfigError: a word stands for nothing, a number is not positive, or the car cannot be.
        """
        for name, value in PRESETS.get(self.preset, {}).items():
            if getattr(self, name) is None:
                by_tyre = name == "integrator" and self.tyre == "brush"
                object.__setattr__(self, name, "rk4" if by_tyre else value)
        super().__post_init__()
        if self.integrator == "euler" and self.tyre == "brush":
            raise ConfigError("vehicle.integrator is 'euler', with which brush tyres are unstable; it must be rk4")
        if self.max_steering >= math.pi / 2:
            raise ConfigError(f"vehicle.max_steering is {self.max_steering}; it must be less than 1.57 rad")
        if self.time_step > 1000 * self.substep:
            raise ConfigError(f"vehicle.substep is {self.substep}; it must be at least a thousandth of the time step")
        if self.pedals == "speed" and self.min_speed == 0:
            raise ConfigError("vehicle.pedals is 'speed'; its brakes need a vehicle.min_speed below 0")
        highest = GRAVITY * min(self.front_axle, self.rear_axle) / self.max_acceleration
        if self.height >= highest:
            raise ConfigError(
                f"vehicle.height is {self.height}; at {highest:.3g} m the car tips over at its max_acceleration"
            )

    def _check_positive(self, names: Iterable[str]) -> None:
        super()._check_positive(name for name in names if name != "min_speed")
        least, value = -MOST, self.min_speed
        if isinstance(value, bool) or not (isinstance(value, int | float) and least <= value <= 0):
            raise ConfigError(f"vehicle.min_speed is {shown(value)}; it must be 0, or less for a car that reverses")

    @property
    def wheelbase(self) -> float:  # type: ignore[override]
        """Between the axles, m."""
        return self.front_axle + self.rear_axle

    @property
    def state_names(self) -> tuple[str, ...]:  # type: ignore[override]
        """Those of every car, and what a servo has been told."""
        return (*MOTION, *COMMANDS) if self.steering == "servo" else MOTION

    @property
    def control_names(self) -> tuple[str, ...]:  # type: ignore[override]
        """Steering wheel, then pedals or speed."""
        return "steer", *_PEDALS[self.pedals]

    @property
    def body(self) -> Rectangle:
        """Its middle is the centre of gravity."""
        return Rectangle(self.length, self.width, self.contact == "corners")

    @property
    def substeps(self) -> int:
        """Of the integrator in a step."""
        return math.ceil(self.time_step / self.substep - 1e-9)

    @property
    def kernel(self) -> Kernel:
        """The same on the CPU."""
        from carrl.sim.single_track_kernel import drive_single_track  # Here, since Numba takes half a second to import.

        return drive_single_track

    @property
    def constants(self) -> tuple[float, ...]:
        """In the order of `carrl.sim.single_track_kernel.Constants`, then the shape of the steering range."""
        grip = self.friction * GRAVITY
        return (
            float(self.tyre == "brush"),
            STEERING.index(self.steering),
            {"speed": 1, "power": 2}.get(self.pedals, 0),
            float(self.integrator == "euler"),
            self.substeps,
            self.time_step / self.substeps,
            self.front_axle,
            self.rear_axle,
            self.mass / self.yaw_inertia,
            grip,
            1 / grip,
            self.rear_axle / self.wheelbase,
            self.height / (GRAVITY * self.wheelbase),
            self.front_stiffness,
            self.rear_stiffness,
            self.max_steering,
            self.steering_rate,
            self.max_acceleration,
            self.power_speed,
            self.max_speed,
            self.min_speed,
            self.slip_speed,
            self.kinematic_below,
            grip * (1 - STEERABLE**2) ** 0.5,
            1 / FULL_SLIP,
            EASE / (2 * self.max_speed),
            EASE / (2 * self.min_speed) if self.min_speed else 0.0,
            EASE,
            REST,
            MOST_SPIN,
            SERVO_DEAD_BAND,
            FORWARD_GAIN,
            BACKWARD_GAIN,
            LEAST_RANGE,
            RANGE_LATERAL,
            RANGE_SLIP,
        )

    def step(self, state: Tensor, control: Tensor) -> Tensor:
        """By the integrator's substeps, each with an even change of the steering angle and the pedals as they are."""
        tyres, substep = TYRES[self.tyre], self.time_step / self.substeps
        car, (steer, *pedals) = state.double(), control.double().unbind(-1)
        motion = tyres.motion(car[:, :3], *(car[:, MOTION.index(name)] for name in ("speed", "slip", "yaw_rate")))
        steering, commands = car[:, MOTION.index("steering")], car[:, len(MOTION) :]
        wanted_angle = steer * self.steering_range(car[:, MOTION.index("speed")])
        felt = torch.zeros_like(motion[:, :2])
        for _ in range(self.substeps):
            turning = self._turning(steering, steer, wanted_angle, commands)
            wanted = self._wanted_acceleration(pedals, motion[:, 3])
            change = self._mean_rates(motion, steering, turning, wanted, substep)
            motion = tyres.settled(self, motion + substep * change[:, :6])
            felt = felt + change[:, 6:] / self.substeps
            steering = steering + substep * turning
            commands = torch.cat([steer[:, None], commands[:, :-1]], dim=-1)[:, : commands.shape[1]]
        speed, slip = tyres.speed_and_slip(motion)
        heading = torch.remainder(motion[:, 2] + math.pi, 2 * math.pi) - math.pi
        values = [*motion[:, :2].unbind(-1), heading, speed, motion[:, 5], slip, steering, *felt.unbind(-1)]
        return torch.cat([torch.stack(values, dim=-1), commands], dim=-1).to(state)

    def rates(self, motion: Tensor, steering: Tensor, turning: Tensor, wanted: Tensor) -> Tensor:
        """What changes of these motions: see `carrl.sim.tyres.Tyres.rates`."""
        return TYRES[self.tyre].rates(self, motion, steering, turning, wanted)

    def _mean_rates(self, motion: Tensor, steering: Tensor, turning: Tensor, wanted: Tensor, time: float) -> Tensor:
        """What changes in a substep, a second, [N, 8]."""
        first = self.rates(motion, steering, turning, wanted)
        if self.integrator == "euler":
            return first
        middle = steering + time / 2 * turning
        second = self.rates(motion + time / 2 * first[:, :6], middle, turning, wanted)
        third = self.rates(motion + time / 2 * second[:, :6], middle, turning, wanted)
        fourth = self.rates(motion + time * third[:, :6], steering + time * turning, turning, wanted)
        return (first + 2 * second + 2 * third + fourth) / 6

    def _turning(self, steering: Tensor, steer: Tensor, wanted_angle: Tensor, commands: Tensor) -> Tensor:
        """How fast the front wheels turn in a substep, [N], rad/s."""
        lock, rate, substep = self.max_steering, self.steering_rate, self.time_step / self.substeps
        if self.steering == "angle":
            return ((wanted_angle - steering) / substep).clamp(-rate, rate)
        if self.steering == "rate":
            turned = (steering + substep * rate * steer).clamp(-lock, lock)
            return (turned - steering) / substep
        ahead = commands[:, 1] * lock - steering
        turning = torch.where(ahead.abs() > SERVO_DEAD_BAND, ahead.sign() * rate, 0.0)
        at_stop = ((steering <= -lock) & (turning <= 0)) | ((steering >= lock) & (turning >= 0))
        return torch.where(at_stop, 0.0, turning)

    def _wanted_acceleration(self, pedals: list[Tensor], speed: Tensor) -> Tensor:
        """What the driver asks for, [N], m/s^2."""
        if self.pedals == "one":
            return pedals[0] * self.max_acceleration
        if self.pedals == "power":
            given = self.max_acceleration * self.power_speed / speed.abs().clamp(min=self.power_speed)
            return torch.where(pedals[0] > 0, pedals[0] * given, pedals[0] * self.max_acceleration)
        if self.pedals == "two":
            return (pedals[0] - pedals[1]) / 2 * self.max_acceleration
        missing = pedals[0].clamp(min=0) * self.max_speed - pedals[0].clamp(max=0) * self.min_speed - speed
        gain = torch.where(speed > 0, torch.full_like(speed, FORWARD_GAIN), BACKWARD_GAIN) * self.max_acceleration
        return missing * gain / torch.where(missing > 0, torch.full_like(speed, self.max_speed), -self.min_speed)
