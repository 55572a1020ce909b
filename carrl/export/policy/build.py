"""From a run's network and world to a `PolicyGraph`."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import nn
from torchrl.modules import NoisyLinear
from torchrl.modules.models import DuelingMlpDQNet

import carrl
from carrl.algorithms.actor_critic.network import Actor
from carrl.algorithms.common.network import Power, QNetwork, ReturnDistribution
from carrl.errors import ConfigError
from carrl.export.policy.controls import control_quantities
from carrl.export.policy.graph import PolicyGraph
from carrl.export.policy.inputs import FLOAT, INDEX, Input, merged, readings_of, state_input
from carrl.sim.sensor import Sensor
from carrl.sim.vehicle import VehicleModel
from carrl.task.action import ActionMap, ContinuousActions, DiscreteActions
from carrl.task.task import World

FORMAT, FORMAT_VERSION = "carrl-policy", 1


def policy_graph(network: nn.Module, world: World, about: Mapping[str, Any]) -> PolicyGraph:
    """The greedy policy of a network.

    Args:
        network: of DQN, or an actor.
        world: that it drives in.
        about: what else the document is to say.

    Raises:
        ConfigError: the network, or what the actions mean, is of a kind that is not known.
    """
    layers = _Layers()
    action = _action(world.action, layers.arrays)
    if (isinstance(network, QNetwork) and action["kind"] == "discrete") or (
        isinstance(network, Actor) and action["kind"] == "continuous"
    ):
        steps = layers.of(network.layers)
    else:
        raise ConfigError(
            f"the run's network is {type(network).__name__}; what can be exported is a QNetwork or an Actor"
        )
    readings = readings_of(world.observation, world.sensor, world.action)
    controls = control_quantities(world.vehicle)
    wanted = [each for reading in readings for each in reading.inputs]
    if any(control.steering_range for control in controls):
        wanted.append(state_input("speed"))
    document = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "carrl_version": carrl.__version__,
        **about,
        "control_period_s": float(world.vehicle.time_step),
        "inputs": [each.document() for each in merged(wanted)],
        "outputs": [each.document() for each in _outputs(world.action)],
        "actions": list(world.action.names),
        "controls": [control.document() for control in controls],
        "first_action": world.action.first.tolist(),
        "sensor": _sensor(world.sensor),
        "vehicle": _vehicle(world.vehicle),
        "observation": [dict(reading.document) for reading in readings],
        "network": steps,
        "action": action,
    }
    return PolicyGraph(document, layers.arrays, layers.own)


def _action(action: ActionMap, arrays: dict[str, np.ndarray]) -> dict[str, Any]:
    if type(action) is DiscreteActions:
        arrays["action.settings"] = action.controls(torch.arange(len(action.names))).numpy()
        arrays["action.one_hot"] = np.eye(len(action.names), dtype=np.float32)
        return {"kind": "discrete", "settings": {name: list(values) for name, values in action.settings.items()}}
    if type(action) is ContinuousActions:
        ranges = [action.ranges.get(name, (-1.0, 1.0)) for name in action.control_names]
        arrays["action.ranges"] = np.array(ranges, dtype=np.float32).T.copy()
        return {"kind": "continuous", "ranges": dict(zip(action.control_names, map(list, ranges), strict=True))}
    raise ConfigError(
        f"action is {type(action).__name__}; what is exported is a choice among DiscreteActions, or ContinuousActions"
    )


def _outputs(action: ActionMap) -> tuple[Input, ...]:
    controls = Input("controls", (len(action.control_names),), "see controls", "what to tell the car")
    if not action.names:
        meaning = "each control within -1 and 1, before its range: the next step's last_action, if that is an input"
        return Input("action", (len(action.control_names),), "1", meaning), controls
    return (
        Input("action", (), "1", "number of the action with the highest value", INDEX),
        Input("action_value", (len(action.names),), "1", "of each action: the return that is expected", FLOAT),
        controls,
    )


def _sensor(sensor: Sensor) -> dict[str, Any]:
    return {
        "rays": sensor.rays,
        "angles_rad": [round(angle, 7) for angle in sensor.angles.double().tolist()],
        "order": "right to left: counter-clockwise from the heading",
        "max_range_m": float(sensor.max_range),
        "mount_m": float(sensor.mount),
        "noise_m": float(sensor.noise),
        "dropout": float(sensor.dropout),
    }


def _vehicle(vehicle: VehicleModel) -> dict[str, Any]:
    values = {name: value for name, value in vars(vehicle).items() if isinstance(value, bool | int | float | str)}
    return {"model": type(vehicle).__name__, **values}


class _Layers:
    """Takes networks apart.

    Attributes:
        arrays: of the layers so far, by name.
        own: layers that are not CarRL's.
    """

    def __init__(self) -> None:
        self.arrays: dict[str, np.ndarray] = {}
        self.own: dict[str, nn.Module] = {}

    def of(self, module: nn.Module) -> list[dict[str, Any]]:
        """The layers of a module, one after the other."""
        if isinstance(module, nn.Sequential):
            return [layer for child in module for layer in self.of(child)]
        if type(module) is DuelingMlpDQNet:
            streams = {
                "advantage": self.of(module.get_submodule("advantage")),
                "value": self.of(module.get_submodule("value")),
            }
            return [*self.of(module.get_submodule("features")), {"kind": "dueling", **streams}]
        if type(module) is ReturnDistribution:
            return [*self.of(module.layers), {"kind": "expectation", "support": self._kept("support", module.support)}]
        return [self._single(module)]

    def _single(self, module: nn.Module) -> dict[str, Any]:
        if type(module) is nn.Linear and module.bias is not None:
            return self._linear(module.weight, module.bias)
        if type(module) is NoisyLinear:
            return self._linear(module.get_parameter("weight_mu"), module.get_parameter("bias_mu"))
        if type(module) is Power:
            return {"kind": "power", "exponent": float(module.exponent)}
        if type(module) is nn.ELU and module.alpha == 1:
            return {"kind": "elu"}
        for kind, activation in (("relu", nn.ReLU), ("tanh", nn.Tanh)):
            if type(module) is activation:
                return {"kind": kind}
        name = f"own{len(self.own)}"
        self.own[name] = module
        return {"kind": "own", "name": name, "type": type(module).__name__}

    def _linear(self, weight: torch.Tensor, bias: torch.Tensor) -> dict[str, Any]:
        number = sum(name.endswith(".weight") for name in self.arrays)
        names = {"weight": f"linear{number}.weight", "bias": f"linear{number}.bias"}
        return {
            "kind": "linear",
            **{
                part: self._kept(name, value) for (part, name), value in zip(names.items(), (weight, bias), strict=True)
            },
        }

    def _kept(self, name: str, value: torch.Tensor) -> str:
        self.arrays[name] = value.detach().cpu().numpy().astype(np.float32)
        return name
