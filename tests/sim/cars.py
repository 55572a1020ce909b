"""Cars that are steered, driven and braked, one or many, for tests."""

import numpy as np
import torch
from torch import Tensor

from carrl.sim.driven import DrivenCar


def at(car: DrivenCar, **values: float) -> Tensor:
    """One car with these values, the others 0, in double precision."""
    return torch.tensor([[values.get(name, 0.0) for name in car.state_names]], dtype=torch.float64)


def drive(car: DrivenCar, state: Tensor, *control: float, steps: int = 1) -> dict[str, float]:
    """The last state by name."""
    for _ in range(steps):
        state = car.step(state, torch.tensor([control], dtype=torch.float64))
    return dict(zip(car.state_names, state[0].tolist(), strict=True))


def by_kernel(car: DrivenCar, state: Tensor, control: Tensor) -> Tensor:
    """The next states by the machine code."""
    return torch.from_numpy(car.kernel(state.numpy(), control.numpy(), np.array(car.constants)))


def random_controls(car: DrivenCar, cars: int, generator: torch.Generator) -> Tensor:
    """[N, C], over all that there is."""
    return 2 * torch.rand(cars, len(car.control_names), generator=generator) - 1


def random_starts(car: DrivenCar, cars: int, generator: torch.Generator) -> Tensor:
    """Anywhere, at any speed forward, [N, S]."""
    speed = car.max_speed * torch.rand(cars, generator=generator)
    return car.initial_state(torch.randn(cars, 3, generator=generator), speed)
