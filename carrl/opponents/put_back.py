"""What becomes of opponents that touch a wall.

Shapes: `N` opponents, `S` entries of a vehicle's state.
"""

from torch import Tensor

from carrl.sim.simulator import CarState, Simulator


def put_back(simulator: Simulator, cars: CarState, after: Tensor, collided: Tensor) -> Tensor:
    """The states after the step, [N, S], but on the middle of the road and at rest for those that have collided.

    Args:
        simulator: where they drive.
        cars: before the step, with their stations, [N].
        after: as they drove on, [N, S].
        collided: which of them touched a wall, [N], bool.
    """
    if not bool(collided.any()):
        return after
    row = collided.nonzero()[:, 0]
    pose = simulator.routes.poses(cars.track[row].cpu(), cars.station[row].cpu())  # type: ignore[index]
    return after.index_copy(0, row, simulator.vehicle.initial_state(pose).to(after))
