"""Where the cars of a world start: in a row along the road, with room between them, or alone where there is room.

Shapes: `N` rows, of which some are wanted, `V` worlds with such rows, `K` cars of each, `S` entries of a vehicle's
state.
"""

import math
from dataclasses import replace

import torch
from torch import Tensor

from carrl.errors import ConfigError
from carrl.sim.others import Others
from carrl.sim.simulator import CarState
from carrl.sim.traffic import Traffic
from carrl.task.episode import Start, StartSampler
from carrl.task.random_streams import RandomStreams

_PLACE, _TRACK, _VARIANT, _ORDER, _GAP, _OFFSET, _HEADING, _SPEED, _OWN = range(9)
"""What each of a car's random numbers decides; the last two of them are an opponent's own."""
_NUMBERS = _OWN + 2
_CLOSE = 0.75
"""Share of the room between two cars that must be left in a straight line, since roads bend."""


class GridSampler(StartSampler):
    """Draws starts for worlds of several cars.

    Where all cars of a world start, they stand one behind the other, in a drawn order and at drawn distances; the first
    one is where a car alone would start. A car that starts while others drive is put there, too, or behind that place
    where there is room, on the track of the others.

    Args:
        start: what to draw.
        simulator: whose tracks are `start.variants` of some tracks.
        rows: how many, N, of each of so many seeds.
        seeds: how many.

    Raises:
        ConfigError: a track is too short for so many cars, or as in `StartSampler`.
    """

    def __init__(self, start: Start, simulator: Traffic, rows: int, seeds: int) -> None:
        super().__init__(start, simulator, rows, seeds)
        self._traffic, self._rows = simulator, simulator.rows_per_world
        self._need = (start.gap + 1) * simulator.vehicle.body.outline.length
        shortest = float(simulator.routes.lengths.min())
        if self._need * simulator.cars_per_world > shortest:
            raise ConfigError(
                f"env.cars_per_world is {simulator.cars_per_world}, which with start.gap={start.gap:g} takes "
                f"{self._need * simulator.cars_per_world:.0f} m of road; the shortest track has {shortest:.0f} m"
            )
        self._own_base = (torch.arange(rows) // self._rows % self._bases).repeat(seeds)

    @property
    def is_always_the_same(self) -> bool:
        """Never: the order and the distances are drawn."""
        return False

    def __call__(self, streams: RandomStreams, wanted: Tensor, now: CarState | None = None) -> CarState:
        """Starts for the wanted rows, [N] bool, on whose worlds other cars are `now`, [N]: as many as are wanted."""
        traffic, count = self._traffic, self._traffic.cars_per_world
        columns = (_NUMBERS,) if self._rows > 1 else (count, _NUMBERS)
        draws = streams.uniform(*columns, wanted=wanted).view(-1, count, _NUMBERS)
        by_world = wanted.view(-1, self._rows)
        world = by_world.any(dim=1).nonzero()[:, 0]
        draws, starts = draws[world], by_world[world].expand(-1, count)
        states, track = self._present(now, world, starts), self._tracks(draws, world, starts, now)
        self._place(states, track, draws, starts)
        states = {name: values.to(traffic.device) for name, values in states.items()}
        track = track.to(traffic.device)
        if self._rows > 1:
            starting = starts.to(traffic.device)
            state, next_gate, passed = (states[name][starting] for name in ("state", "next_gate", "gates_passed"))
            return CarState(state, next_gate, passed, track[:, None].expand(-1, count)[starting])
        state, next_gate, passed = (states[name][:, 0] for name in ("state", "next_gate", "gates_passed"))
        found = {name: values[:, 1:].contiguous() for name, values in states.items()}
        others = Others(**found, lane=torch.zeros_like(found["station"]))
        begun = traffic.opponents.begin(traffic, others, draws[:, 1:, _OWN:], track)  # type: ignore[union-attr]
        return CarState(state, next_gate, passed, track, others=begun)

    def _present(self, now: CarState | None, world: Tensor, starts: Tensor) -> dict[str, Tensor]:
        """The state of the worlds [V, K] as it is, with cars that start far from everywhere."""
        shape = tuple(starts.shape)
        states = {
            "state": torch.full((*shape, len(self._traffic.vehicle.state_names)), math.inf),
            "next_gate": torch.zeros(shape, dtype=torch.int64),
            "gates_passed": torch.zeros(shape, dtype=torch.int64),
            "station": torch.zeros(shape),
        }
        if starts.all():
            return states
        if now is None:
            raise ConfigError("cars that share a world with others cannot start without their state; reset them all")
        driving = now.state.cpu().view(-1, shape[1], now.state.shape[1])[world]
        states["state"] = torch.where(starts[..., None], math.inf, driving)
        return states

    def _tracks(self, draws: Tensor, world: Tensor, starts: Tensor, now: CarState | None) -> Tensor:
        """The track of each world, [V]."""
        first = draws[:, 0]
        own = self._own_base.view(-1, self._rows)[world, 0]
        base = (first[:, _TRACK] * self._bases).long() if self._samples_track else own
        track = base * self._variants + (first[:, _VARIANT] * self._variants).long()
        whole = starts.all(dim=1)
        if bool(whole.all()) or now is None:
            return track
        driven = now.track.cpu().view(-1, starts.shape[1])[world]
        stays = driven.gather(1, (~starts).long().argmax(dim=1, keepdim=True))[:, 0]
        return torch.where(whole, track, stays)

    def _place(self, states: dict[str, Tensor], track: Tensor, draws: Tensor, starts: Tensor) -> None:
        """Writes the states of those that start, [V, K], one after the other."""
        length, count, whole = self._traffic.routes.lengths[track], starts.shape[1], starts.all(dim=1)
        order = self._order(draws, starts)
        worlds = torch.arange(len(track))
        station = draws[:, 0, _PLACE] * length if self._start.anywhere else torch.zeros_like(length)
        lone = draws[worlds, order[:, 0], _PLACE] * length if self._start.anywhere else torch.zeros_like(length)
        station = torch.where(whole, station, lone)
        room = torch.where(whole, _CLOSE * self._need, self._need)
        most = (length / count - self._need).clamp(max=self._need)
        for rank in range(count):
            car = order[:, rank]
            here = starts[worlds, car].nonzero()[:, 0]
            if not len(here):
                return
            own = draws[here, car[here]]
            put, found = self._free(states["state"][here], track[here], station[here], own, room[here])
            for name in ("state", "next_gate"):
                states[name][here, car[here]] = getattr(put, name).cpu()
            states["station"][here, car[here]] = (found % length[here]).float()
            station[here] = found - self._need - own[:, _GAP] * most[here]

    def _order(self, draws: Tensor, starts: Tensor) -> Tensor:
        """The cars of each world from the first one to be placed to the last, those that do not start at the end."""
        key = draws[..., _ORDER].clone()
        if self._rows == 1 and self._start.order != "random":
            key[:, 0] = -1.0 if self._start.order == "first" else 2.0
        return torch.where(starts, key, 3.0).argsort(dim=1)

    def _free(
        self, driving: Tensor, track: Tensor, station: Tensor, draws: Tensor, room: Tensor
    ) -> tuple[CarState, Tensor]:
        """One car for each world, [V], at its station or behind it, and its station; with room if there is any."""
        found, close = station.clone(), 2 * self._traffic.vehicle.body.outline.reach
        tries = math.ceil(2 * float(self._traffic.routes.lengths[track].max()) / self._need) + 1
        for least in (room, torch.full_like(room, 1.01 * close)):
            blocked, cars = torch.arange(len(track)), self._start_at(found, track, draws)
            for _ in range(tries):
                away = torch.linalg.vector_norm(driving[blocked, :, :2] - cars.pose[blocked, None, :2].cpu(), dim=-1)
                blocked = blocked[~(away.nan_to_num(math.inf) >= least[blocked, None]).all(dim=1)]
                if not len(blocked):
                    return cars, found
                found[blocked] -= self._need / 2
                cars = self._start_at(found, track, draws)
        raise ConfigError("there is no room left on the road to start a car; choose a smaller env.cars_per_world")

    def _start_at(self, station: Tensor, track: Tensor, draws: Tensor) -> CarState:
        """Cars at stations [V], beside the middle, turned and as fast as drawn."""
        start, spread = self._start, 2 * draws - 1
        speed = None
        if start.speed or start.speed_spread:
            speed = (start.speed + start.speed_spread * spread[:, _SPEED]).clamp(min=0)
        return self._simulator.start(
            stations=station,
            track=track,
            offset=start.offset * spread[:, _OFFSET] if start.offset else None,
            heading=math.radians(start.heading_jitter) * spread[:, _HEADING] if start.heading_jitter else None,
            speed=speed,
        )


def behind_opponents(traffic: Traffic, cars: CarState, stations: Tensor, gap: float, draws: Tensor) -> CarState:
    """The cars [V], each with the opponents of its world in a row before it.

    Args:
        traffic: with the opponents, M to a world.
        cars: at their starts.
        stations: of these, m, [V].
        gap: between two cars, at least, in lengths of the car.
        draws: random numbers of each opponent, [V, M, 3], float64, in 0..1: for its distance, and two of its own.
    """
    track, count = cars.track, traffic.cars_per_world
    need = (gap + 1) * traffic.vehicle.body.outline.length
    most = (traffic.routes.lengths[track.cpu()] / count - need).clamp(0, need)
    ahead = stations.cpu()[:, None] + (need + draws[..., 0] * most[:, None]).cumsum(dim=1)
    shape = tuple(ahead.shape)
    put = traffic.start(ahead.flatten(), track.repeat_interleave(count - 1))
    station = (ahead % traffic.routes.lengths[track.cpu(), None]).float().to(traffic.device)
    found = {name: getattr(put, name).unflatten(0, shape) for name in ("state", "next_gate", "gates_passed")}
    others = Others(**found, station=station, lane=torch.zeros_like(station))
    begun = traffic.opponents.begin(traffic, others, draws[..., 1:], track)  # type: ignore[union-attr]
    return replace(cars, others=begun)
