"""VMAS, the batched simulator in PyTorch, on our road: one car with a lidar between walls, in N worlds side by side.

All that it does beyond moving, colliding and sensing is as cheap as we can make it: cars are put back all at once and
not world by world, the lidar is read once a step, a collision is read from the lidar instead of measured against every
wall, and there are no gates.

Shapes: `N` cars, `R` rays, `S` walls.
"""

import math
from typing import Any

import torch
from torch import Tensor
from vmas import make_env
from vmas.simulator.core import Agent, Landmark, Line, Sphere, World
from vmas.simulator.dynamics.static import Static
from vmas.simulator.environment import Environment
from vmas.simulator.scenario import BaseScenario
from vmas.simulator.sensors import Lidar

from carrl.sim.sensor import Sensor
from carrl.sim.vehicle import Vehicle


class WalledRoad(BaseScenario):
    """A car as fast and as agile as ours; actions are [N, 1]: 0 forward, 1 left, -1 right.

    An episode ends where a wall is nearer than the car's radius or, within thirty degrees of the heading, nearer than
    one step: VMAS does not sweep the body along its way, so the car would otherwise pass through the wall.
    """

    def make_world(
        self, batch_dim: int, device: torch.device, *, walls: Tensor, start: Tensor, vehicle: Vehicle, sensor: Sensor
    ) -> World:
        """Builds the car and walls [S, 2, 2], m; cars begin at `start`, x m, y m, heading rad, [N, 3]."""
        self._walls, self._start, self._vehicle, self._max_range = walls, start, vehicle, sensor.max_range
        world = World(batch_dim, device, dt=vehicle.time_step, drag=0.0)
        half = math.radians(sensor.field_of_view) / 2
        lidar = Lidar(world, angle_start=-half, angle_end=half, n_rays=sensor.rays, max_range=sensor.max_range)
        self._car = Agent(
            "car", shape=Sphere(vehicle.body_radius), dynamics=Static(), action_size=1, sensors=[lidar], drag=0.0
        )
        world.add_agent(self._car)
        for number, (begin, end) in enumerate(walls):
            length = (end - begin).norm().item()
            world.add_landmark(Landmark(f"wall {number}", shape=Line(length), collision_filter=_is_car))
        near = torch.full((sensor.rays,), vehicle.body_radius)
        near[sensor.angles.abs() < math.radians(31)] = vehicle.step_length
        self._too_near = near
        return world

    def reset_world_at(self, env_index: int | None = None) -> None:
        """Puts the walls in their places and the cars at their starts."""
        for wall, (begin, end) in zip(self.world.landmarks, self._walls, strict=True):
            way = end - begin
            wall.set_pos((begin + end) / 2, batch_index=env_index)
            wall.set_rot(torch.atan2(way[1:], way[:1]), batch_index=env_index)
        chosen = slice(None) if env_index is None else env_index
        self._car.set_pos(self._start[chosen, :2], batch_index=env_index)
        self._car.set_rot(self._start[chosen, 2:], batch_index=env_index)
        self._look()

    def process_action(self, agent: Agent) -> None:
        """Turns the heading first, then drives along it, as ours does."""
        yaw = agent.action.u * self._vehicle.yaw_per_step
        heading = agent.state.rot + yaw
        way = torch.cat([heading.cos(), heading.sin()], dim=-1)
        agent.set_vel(way * self._vehicle.speed, batch_index=None)
        agent.set_ang_vel(yaw / self._vehicle.time_step, batch_index=None)

    def post_step(self) -> None:
        """Looks, and puts the cars that have collided back where they began."""
        self._look()
        back = self._collided[:, None]
        self._car.set_pos(torch.where(back, self._start[:, :2], self._car.state.pos), batch_index=None)
        self._car.set_rot(torch.where(back, self._start[:, 2:], self._car.state.rot), batch_index=None)

    def observation(self, agent: Agent) -> Tensor:
        """Distance along each ray / range, [N, R]."""
        return self._ranges / self._max_range

    def reward(self, agent: Agent) -> Tensor:
        """For collisions and for nearness to a wall, [N]."""
        near = (self._ranges < 0.1 * self._max_range).any(dim=-1)
        return -200.0 * self._collided - 20.0 * near

    def done(self) -> Tensor:
        """Which cars have collided, [N]."""
        return self._collided

    def _look(self) -> None:
        self._ranges = self._car.sensors[0].measure()
        self._collided = (self._ranges < self._too_near).any(dim=-1)


def make_road(walls: Tensor, start: Tensor, vehicle: Vehicle, sensor: Sensor) -> Environment:
    """VMAS with a car at each pose of `start`, [N, 3], between walls [S, 2, 2]."""
    options: dict[str, Any] = {"walls": walls, "start": start, "vehicle": vehicle, "sensor": sensor}
    return make_env(WalledRoad(), num_envs=len(start), device="cpu", continuous_actions=True, **options)


def thin_out(walls: Tensor, count: int) -> Tensor:
    """A coarser road: every wall [S, 2, 2] has a left and a right loop of S / 2, of which `count` chords are left."""
    loops = walls.view(2, -1, 2, 2)
    kept = torch.arange(count // 2) * loops.shape[1] // (count // 2)
    corners = loops[:, kept, 0]
    return torch.stack([corners, corners.roll(-1, dims=1)], dim=2).view(-1, 2, 2)


def _is_car(entity: Any) -> bool:
    """Keeps VMAS from considering whether walls collide with each other."""
    return isinstance(entity, Agent)
