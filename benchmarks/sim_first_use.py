"""How long the simulator takes to be ready: `python -m benchmarks.sim_first_use` prints the seconds."""

import tempfile
import time

from benchmarks.child import run_child
from benchmarks.recipes import CACHES


def time_first_use() -> dict[str, float]:
    """Seconds by the state of the caches of compiled code, each in a process of its own.

    Raises:
        BenchError: it failed.
    """
    with tempfile.TemporaryDirectory() as folder:
        caches = {variable: f"{folder}/{variable}" for variable in CACHES}
        return {state: float(run_child(["-m", "benchmarks.sim_first_use"], caches)[0]) for state in ("empty", "filled")}


def main() -> None:
    """Makes a simulator and drives one car by a step; imports of torch are not counted, those of compilers are."""
    import torch

    from carrl.sim.sensor import Sensor
    from carrl.sim.simulator import Simulator
    from carrl.sim.vehicle import Vehicle
    from carrl.tracks.track import Track

    torch.set_num_threads(1)
    track = Track.load("paper")
    began = time.perf_counter()
    simulator = Simulator(track, Vehicle(), Sensor())
    simulator.step(simulator.start(torch.zeros(1, dtype=torch.float64)), torch.zeros(1, 1))
    print(time.perf_counter() - began)


if __name__ == "__main__":
    main()
