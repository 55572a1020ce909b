"""Runs of many kinds with random weights, and their exported policies."""

import numpy as np

import carrl
from carrl.cli.main import main
from carrl.export.policy import compiled_header
from carrl.export.policy.verify import random_inputs
from carrl.train.build import ANY_TRACK, build_world, load_greedy_policy
from tests.export.untrained_runs import write_untrained_run

CASES = {
    "paper": [],
    "smooth": ["experiment=smooth"],
    "dueling_table": ["experiment=brake", "loss=dueling"],
    "distributional": ["loss=distributional", "network.input_exponent=0.5"],
    "noisy": ["network=noisy", "vehicle=bicycle"],
    "racer": ["experiment=racer"],
    "gran_turismo": ["experiment=gran_turismo"],
    "torcs": ["experiment=torcs", "network.activation=tanh"],
    "f1tenth": ["experiment=f1tenth", "track.name_or_path=oval"],
    "td3": ["loss=td3", "vehicle=kinematic", "vehicle.steering=rate", "network.activation=elu"],
}
ENDINGS = {"onnx": ".onnx", "torch": ".pt2", "npz": ".npz", "c": ".h"}


class Exports:
    """Runs of the cases, and what `carrl export` made of them, each made once."""

    def __init__(self, folder):
        self._folder = folder

    def run(self, case):
        folder = self._folder / case
        return folder if folder.exists() else write_untrained_run(folder, *CASES[case])

    def file(self, case, kind):
        path = self.run(case) / f"policy{ENDINGS[kind]}"
        if not path.exists():
            assert main(["export", str(self.run(case)), "--format", kind]) == 0
        return path

    def world(self, case):
        return build_world({**carrl.Run.load(self.run(case)).config, "track": ANY_TRACK})

    def own(self, case):
        """The run's own greedy policy."""
        run = carrl.Run.load(self.run(case))
        return load_greedy_policy(run.folder, "best", run.config, self.world(case))

    def computed(self, case, kind, inputs):
        """What an exported file computes."""
        path = self.file(case, kind)
        if kind != "c":
            return carrl.load_policy(path)(**inputs)
        metadata = carrl.load_policy(self.file(case, "npz")).metadata
        return compiled_header(path, "policy", metadata, self.run(case))(inputs)

    def inputs(self, case, count):
        """Random inputs of so many cars."""
        metadata = carrl.load_policy(self.file(case, "npz")).metadata
        return random_inputs(metadata, self.world(case), count, np.random.default_rng(1))
