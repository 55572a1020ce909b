"""How a car with two axles moves on its tyres: what changes of its motion, and how fast.

A motion is a row of six numbers: x, y, heading, two that say how the centre of gravity moves (`Brush`: its speed along
and across the car; `Linear`: its speed and its direction against the heading), and the yaw rate.

Shapes: `N` cars. Units: m, s, rad; angles counter-clockwise and to the left positive.
"""

from typing import TYPE_CHECKING, Protocol

import torch
from torch import Tensor

from carrl.sim.driven import GRAVITY

if TYPE_CHECKING:
    from carrl.sim.single_track import SingleTrack

STEERABLE = 0.2
"""So much of the grip is left to steer with, however hard a car with brush tyres brakes or drives."""
FULL_SLIP = 3.0
"""The slip, in stiffnesses, at which all of a brush has come to slide."""
EASE = 20.0
"""1/s; brakes ease off as a car stops, and the engine as it reaches full speed, within 1 / EASE seconds."""
REST = 1e-6
"""m/s; a car with brush tyres that is slower stands."""
MOST_SPIN = 1e3
"""Beyond this yaw rate, rad/s, and slip, rad, a car with linear tyres stays as it is: they know no limit themselves."""


class Tyres(Protocol):
    """What tyres make of a car."""

    @staticmethod
    def motion(place: Tensor, speed: Tensor, slip: Tensor, yaw_rate: Tensor) -> Tensor:
        """The motions [N, 6] of cars at places (x, y, heading), [N, 3], with speeds, slips and yaw rates, [N] each."""

    @staticmethod
    def speed_and_slip(motion: Tensor) -> tuple[Tensor, Tensor]:
        """Of these motions, [N] each."""

    @staticmethod
    def rates(car: "SingleTrack", motion: Tensor, steering: Tensor, turning: Tensor, wanted: Tensor) -> Tensor:
        """What changes of the motions [N, 6], a second; then the accelerations along and across the car: [N, 8].

        Args:
            car: whose parameters count.
            motion: [N, 6].
            steering: angle of the front wheels, [N].
            turning: how fast that changes, [N].
            wanted: the acceleration that the driver asks for, negative to brake, [N].
        """

    @staticmethod
    def settled(car: "SingleTrack", motion: Tensor) -> Tensor:
        """The motions [N, 6] after a step of the integrator, within their limits."""


class Brush:
    """Tyres whose bristles bend until they slide: the grip has a limit, which braking and cornering share.

    An axle's lateral force is friction * load * g * (1 - (1 - |y| / 3)^3) against its slip, and all of
    friction * load * g from |y| = 3 on, where y is stiffness * slip / g, the slip is the tangent of the slip angle, and
    g is what the longitudinal force leaves of the grip, sqrt(1 - (F_x / (friction * load))^2). The load moves to the
    rear as the car accelerates. Brakes and engine share their force among the axles by load, so that both reach the
    limit together.

    Below `slip_speed` the slip is taken against this speed: slow tyres then are dampers, and the car follows its front
    wheels as the kinematic bicycle does, without a switch between models, and comes to rest.

    Source: Pacejka, "Tyre and Vehicle Dynamics" (2012), sections 1.3 and 3.2.
    """

    @staticmethod
    def motion(place: Tensor, speed: Tensor, slip: Tensor, yaw_rate: Tensor) -> Tensor:
        """With the speed along and across the car."""
        return torch.cat([place, torch.stack([speed * slip.cos(), speed * slip.sin(), yaw_rate], dim=-1)], dim=-1)

    @staticmethod
    def speed_and_slip(motion: Tensor) -> tuple[Tensor, Tensor]:
        """From the speed along and across; 0 of a car that stands."""
        speed = torch.hypot(motion[:, 3], motion[:, 4])
        moves = speed >= REST
        return torch.where(moves, speed, 0.0), torch.where(moves, torch.atan2(motion[:, 4], motion[:, 3]), 0.0)

    @staticmethod
    def rates(car: "SingleTrack", motion: Tensor, steering: Tensor, turning: Tensor, wanted: Tensor) -> Tensor:
        """By the forces of both axles, with all angles as they are."""
        _, _, heading, along, across, yaw_rate = motion.unbind(-1)
        cos, sin, cos_steering, sin_steering = heading.cos(), heading.sin(), steering.cos(), steering.sin()
        grip = car.friction * GRAVITY
        most = (1 - STEERABLE**2) ** 0.5 * grip
        drive = Brush.limited(car, along, across, wanted).clamp(-most, most)
        left = (1 - (drive / grip).square()).sqrt()
        front_across, rear_across = across + car.front_axle * yaw_rate, across - car.rear_axle * yaw_rate
        front_along = along * cos_steering + front_across * sin_steering
        front_aside = front_across * cos_steering - along * sin_steering
        front_drive, rear_drive = Brush.at_wheel(car, front_along, drive), Brush.at_wheel(car, along, drive)
        front_load = (GRAVITY * car.rear_axle - rear_drive * car.height) / (GRAVITY * car.wheelbase)
        slip_speed = car.slip_speed
        front = grip * front_load * Brush.force(front_aside, front_along, car.front_stiffness, slip_speed, left)
        rear = grip * (1 - front_load) * Brush.force(rear_across, along, car.rear_stiffness, slip_speed, left)
        front_pull = front_load * front_drive * cos_steering - front * sin_steering
        front_push = front_load * front_drive * sin_steering + front * cos_steering
        acceleration, lateral = front_pull + (1 - front_load) * rear_drive, front_push + rear
        changes = [
            along * cos - across * sin,
            along * sin + across * cos,
            yaw_rate,
            acceleration + yaw_rate * across,
            lateral - yaw_rate * along,
            (car.front_axle * front_push - car.rear_axle * rear) * (car.mass / car.yaw_inertia),
            acceleration,
            lateral,
        ]
        return torch.stack(changes, dim=-1)

    @staticmethod
    def force(sideways: Tensor, ahead: Tensor, stiffness: float, slip_speed: float, left: Tensor) -> Tensor:
        """The lateral force of a tyre that moves so, [N] m/s each, as a share of friction * load, [N], -1..1.

        `left`, [N], is the share of the grip that the longitudinal force leaves.
        """
        slip = stiffness / left * sideways / ahead.abs().clamp(min=slip_speed)
        return -left * slip.sign() * (1 - (1 - slip.abs().clamp(max=FULL_SLIP) / FULL_SLIP) ** 3)

    @staticmethod
    def limited(car: "SingleTrack", along: Tensor, across: Tensor, wanted: Tensor) -> Tensor:
        """What engine and brakes can give of the acceleration asked for, at speeds along and across the car, [N]."""
        wanted, energy = wanted.clamp(min=-car.max_acceleration), along.square() + across.square()
        strongest = car.max_acceleration * car.power_speed / along.abs().clamp(min=car.power_speed)
        forward = EASE / (2 * car.max_speed) * (car.max_speed**2 - energy)  # EASE times what is missing of max_speed
        drive = torch.minimum(wanted, torch.minimum(strongest, forward))
        if car.min_speed == 0:
            return torch.where(wanted >= 0, drive, wanted)
        backward = EASE / (2 * car.min_speed) * (car.min_speed**2 - energy)
        reverse = torch.where(along < 0, torch.maximum(wanted, backward), wanted)
        return torch.where(wanted >= 0, drive, reverse)

    @staticmethod
    def at_wheel(car: "SingleTrack", speed: Tensor, drive: Tensor) -> Tensor:
        """The acceleration by a wheel that rolls at this speed, [N]; brakes of a car without reverse act against it."""
        if car.min_speed < 0:
            return drive
        return torch.where(drive >= 0, drive, -torch.maximum(torch.minimum(EASE * speed, -drive), drive))

    @staticmethod
    def settled(car: "SingleTrack", motion: Tensor) -> Tensor:
        """As they are: the forces keep the limits."""
        return motion


class Linear:
    """The tyres of CommonRoad's single-track model and of F1TENTH's: a force in proportion to the slip, without limit.

    All angles are taken as small, the speed changes by what engine and brakes do and by nothing else, and below
    `kinematic_below` the wheels roll where they point.

    Source: Althoff and Wuersching, "CommonRoad: Vehicle Models" (2020), section 7; f1tenth_gym for low speeds.
    """

    @staticmethod
    def motion(place: Tensor, speed: Tensor, slip: Tensor, yaw_rate: Tensor) -> Tensor:
        """With the speed and its direction."""
        return torch.cat([place, torch.stack([speed, slip, yaw_rate], dim=-1)], dim=-1)

    @staticmethod
    def speed_and_slip(motion: Tensor) -> tuple[Tensor, Tensor]:
        """As they are."""
        return motion[:, 3], motion[:, 4]

    @staticmethod
    def rates(car: "SingleTrack", motion: Tensor, steering: Tensor, turning: Tensor, wanted: Tensor) -> Tensor:
        """By the linear equations, or the kinematic ones at low speed."""
        _, _, heading, speed, slip, yaw_rate = motion.unbind(-1)
        drive = Linear.limited(car, speed, wanted)
        slow = speed.abs() < car.kinematic_below
        direction = heading + torch.where(slow, 0.0, slip)
        v = torch.where(slow, 1.0, speed)  # where it divides
        front = car.front_stiffness * (GRAVITY * car.rear_axle - drive * car.height)
        rear = car.rear_stiffness * (GRAVITY * car.front_axle + drive * car.height)
        a, b = car.front_axle, car.rear_axle
        by_force = car.friction * car.mass / (car.yaw_inertia * car.wheelbase)
        yaw = by_force * (
            a * front * steering + (b * rear - a * front) * slip - (a * a * front + b * b * rear) * yaw_rate / v
        )
        turn = (
            car.friction
            / (v * car.wheelbase)
            * (front * steering - (rear + front) * slip + (b * rear - a * front) * yaw_rate / v)
        )
        kinematic_yaw_rate = speed / car.wheelbase * steering.tan()
        kinematic_yaw = (drive * steering.tan() + speed * turning / steering.cos().square()) / car.wheelbase
        heading_change = torch.where(slow, kinematic_yaw_rate, yaw_rate)
        slip_change = torch.where(slow, 0.0, turn - yaw_rate)
        changes = [
            speed * direction.cos(),
            speed * direction.sin(),
            heading_change,
            drive,
            slip_change,
            torch.where(slow, kinematic_yaw, yaw),
            drive,
            speed * (heading_change + slip_change),
        ]
        return torch.stack(changes, dim=-1)

    @staticmethod
    def limited(car: "SingleTrack", speed: Tensor, wanted: Tensor) -> Tensor:
        """What is given of the acceleration asked for at this speed, [N]."""
        strongest = car.max_acceleration * car.power_speed / speed.clamp(min=car.power_speed)
        given = torch.minimum(wanted.clamp(min=-car.max_acceleration), strongest)
        at_limit = ((speed <= car.min_speed) & (wanted <= 0)) | ((speed >= car.max_speed) & (wanted >= 0))
        return torch.where(at_limit, 0.0, given)

    @staticmethod
    def settled(car: "SingleTrack", motion: Tensor) -> Tensor:
        """With a speed that the car drives, and a spin that can be computed with."""
        place, speed, spin = motion.split([3, 1, 2], dim=-1)
        return torch.cat([place, speed.clamp(car.min_speed, car.max_speed), spin.clamp(-MOST_SPIN, MOST_SPIN)], dim=-1)


TYRES: dict[str, type[Brush] | type[Linear]] = {"brush": Brush, "linear": Linear}
