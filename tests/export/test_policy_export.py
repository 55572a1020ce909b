"""Exported policies do what the run's own do, from metres to controls, in every format."""

import json
import math
import shutil
import subprocess
import sys

import numpy as np
import pytest
import torch

import carrl
from carrl.cli.main import main
from carrl.errors import CarrlError
from carrl.export.policy.graph import LAYERS
from carrl.export.policy.verify import difference, observation_of, verify
from tests.export.policies import CASES, ENDINGS, Exports
from tests.export.untrained_runs import write_untrained_run

MANY = {"paper": 100_000, "smooth": 100_000}
FEWER = 10_000


@pytest.fixture(scope="module")
def exports(tmp_path_factory):
    return Exports(tmp_path_factory.mktemp("exports"))


QUICK = [(case, kind) for case in CASES for kind in ("npz", "c")]
SLOW = [(case, kind) for case in ("smooth", "dueling_table", "distributional", "f1tenth") for kind in ("onnx", "torch")]


@pytest.mark.slow
@pytest.mark.parametrize(("case", "kind"), [*QUICK, *SLOW])
def test_on_many_random_inputs_the_actions_are_the_run_s_own(exports, case, kind):
    if kind == "c" and shutil.which("cc") is None:
        pytest.skip("there is no C compiler")
    inputs, world = exports.inputs(case, MANY.get(case, FEWER)), exports.world(case)
    action = exports.own(case)(observation_of(world, inputs))
    found = exports.computed(case, kind, inputs)
    if action.dtype == torch.int64:
        np.testing.assert_array_equal(found["action"], action)
        assert len(np.unique(action)) > 1
    else:
        np.testing.assert_allclose(found["action"], action, atol=1e-5, rtol=0)
        assert action.std(dim=0).min() > 0.01


@pytest.mark.parametrize("case", ["smooth", "f1tenth", "racer", "gran_turismo", "torcs"])
def test_a_driver_that_is_told_what_the_simulator_knows_drives_as_the_run_s_policy(exports, case):
    world, driver = exports.world(case), carrl.load_policy(exports.file(case, "npz")).driver()
    assert world.sensor.noise in (0, 0.01)
    object.__setattr__(world.sensor, "noise", 0.0)
    simulator = world.simulator(world.track)
    task, own = world.evaluation_task(simulator, 3), exports.own(case)
    start = {} if case == "smooth" else {"speed": torch.tensor([2.0, 3.0, 4.0])}
    now = task.start_at(simulator.start(torch.tensor([0.0, 30.0, 70.0]), **start))
    told = {each["name"] for each in driver._policy.metadata["inputs"]} - {"last_action", "previous_rays"}
    for _ in range(8):
        found = driver(**{name: measured(name, task, now.state).numpy() for name in told})
        action = own(now.observation)
        np.testing.assert_allclose(found["action"], action, atol=1e-5, rtol=0)
        now = task.step(now.state, action)


def measured(name, task, state):
    """An input by its name, from the simulator."""
    simulator, cars = task.simulator, state.cars
    values = dict(zip(simulator.vehicle.state_names, cars.state.unbind(-1), strict=True))
    if name == "rays":
        return simulator.sense(cars)
    if name in values:
        return values[name]
    if name == "contact":
        return state.contact.float()
    place = simulator.place(cars)
    if name == "curvatures":
        speed = values["speed"].double()
        return simulator.places.curvatures(cars.track, place.station, speed, 0.2 * speed, 10)
    return {"heading_error": place.heading_error, "track_position": place.side}[name]


def test_the_paper_s_car_is_told_a_yaw_rate(exports):
    found = exports.computed("paper", "npz", exports.inputs("paper", 50))
    yaw_rates = np.array([0, 10 / 7.2, -10 / 7.2])  # forward, left, right
    np.testing.assert_allclose(found["controls"][:, 0], yaw_rates[found["action"]], rtol=1e-6)


def test_a_bicycle_is_told_the_angle_of_its_front_wheel(exports):
    found = exports.computed("noisy", "npz", exports.inputs("noisy", 50))
    angles = np.radians([0.0, 8.0, -8.0])
    np.testing.assert_allclose(found["controls"][:, 0], angles[found["action"]], rtol=1e-6)


@pytest.mark.parametrize("kind", ["npz", "c"])
def test_f1tenth_s_car_is_told_an_angle_of_at_most_0_4_rad_and_1_to_8_metres_a_second(exports, kind):
    found = exports.computed("f1tenth", kind, exports.inputs("f1tenth", 50))
    expected = [0.4, 3.5] * found["action"] + [0.0, 4.5]
    np.testing.assert_allclose(found["controls"], expected, atol=1e-5)


@pytest.mark.parametrize("kind", ["npz", "c"])
def test_a_car_whose_steering_range_narrows_is_told_the_angle_within_it(exports, kind):
    inputs = exports.inputs("torcs", 50)
    inputs["speed"][0] = 0.0
    found = exports.computed("torcs", kind, inputs)
    most = exports.world("torcs").vehicle.steering_range(torch.from_numpy(inputs["speed"])).numpy()
    assert most[0] == pytest.approx(1.07) and most.min() < 0.3
    np.testing.assert_allclose(found["controls"][:, 0], found["action"][:, 0] * most, atol=1e-5)
    np.testing.assert_allclose(found["controls"][:, 1:], (found["action"][:, 1:] + 1) / 2, atol=1e-5)


def test_a_pedal_is_an_acceleration_and_a_steering_rate_has_its_unit(exports):
    found = exports.computed("td3", "npz", exports.inputs("td3", 50))
    steer, pedal = found["action"].T
    np.testing.assert_allclose(found["controls"][:, 0], 0.8 * steer, rtol=1e-5)
    np.testing.assert_allclose(found["controls"][:, 1], pedal * np.where(pedal > 0, 5.0, 10.0), rtol=1e-5)
    controls = carrl.load_policy(exports.file("td3", "npz")).metadata["controls"]
    assert [each["unit"] for each in controls] == ["rad/s", "m/s^2"]


@pytest.mark.parametrize("kind", ["npz", "c"])
def test_no_echo_is_the_sensor_s_range_however_the_scanner_says_so(exports, kind):
    scans = np.full((4, 7), 3.0, np.float32)
    scans[:, 2] = [10.0, 30.0, np.inf, np.nan]
    values = exports.computed("paper", kind, {"rays": scans})["action_value"]
    np.testing.assert_array_equal(values, np.repeat(values[:1], 4, axis=0))
    scans[:, 2] = [0.0, -1.0, -np.inf, 0.0]
    values = exports.computed("paper", kind, {"rays": scans})["action_value"]
    np.testing.assert_array_equal(values, np.repeat(values[:1], 4, axis=0))


@pytest.mark.slow
def test_every_format_has_the_same_metadata(exports):
    policies = [carrl.load_policy(exports.file("f1tenth", kind)) for kind in ("npz", "torch", "onnx")]
    first = policies[0].metadata
    assert all(policy.metadata == first for policy in policies)
    header = exports.file("f1tenth", "c").read_text()
    line = next(line for line in header.splitlines() if line.startswith("{"))
    assert json.loads(line) == first
    assert (first["control_period_s"], first["carrl_version"]) == (0.04, carrl.__version__)
    assert first["vehicle"]["max_speed"] == 20.0
    assert [(each["name"], each["unit"]) for each in first["controls"]] == [("steer", "rad"), ("speed", "m/s")]
    assert first["sensor"]["angles_rad"] == pytest.approx(exports.world("f1tenth").sensor.angles.tolist(), abs=1e-6)


@pytest.mark.slow
def test_the_onnx_model_names_its_inputs_outputs_and_batch_and_no_place_of_this_machine(exports):
    import onnx

    path = exports.file("f1tenth", "onnx")
    model = onnx.load(path)
    sizes = {
        each.name: [size.dim_param or size.dim_value for size in each.type.tensor_type.shape.dim]
        for each in (*model.graph.input, *model.graph.output)
    }
    assert sizes == {
        "rays": ["batch", 20],
        "previous_rays": ["batch", 1, 20],
        "speed": ["batch"],
        "action": ["batch", 2],
        "controls": ["batch", 2],
    }
    assert b"carrl/export" not in path.read_bytes()


@pytest.mark.parametrize(("compiler", "flags"), [("cc", ["-std=c99", "-pedantic"]), ("g++", ["-x", "c++"])])
def test_headers_compile_without_a_warning(exports, compiler, flags, tmp_path):
    if shutil.which(compiler) is None:
        pytest.skip(f"there is no {compiler}")
    names = ("dueling_table", "distributional", "gran_turismo", "f1tenth")
    for case in names:
        assert main(["export", str(exports.run(case)), "--format", "c", "--out", str(tmp_path / f"{case}.h")]) == 0
    uses = [f"(void){case}_start, (void){case}_act, (void){case}_next;" for case in names]
    includes = "".join(f'#include "{case}.h"\n' for case in names)
    source = tmp_path / "all.c"
    source.write_text(f"{includes}int main(void) {{ {' '.join(uses)} return 0; }}\n")
    command = [compiler, *flags, "-Wall", "-Wextra", "-Werror", "-o", str(tmp_path / "all"), str(source), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_policy_that_does_otherwise_is_found_out(exports):
    metadata, world, own = (
        carrl.load_policy(exports.file("smooth", "npz")).metadata,
        exports.world("smooth"),
        exports.own("smooth"),
    )
    policy = carrl.load_policy(exports.file("smooth", "npz"))
    verify(lambda inputs: policy(**inputs), metadata, own, world)
    doubled = {"rays": 2.0, "last_action": 1}
    with pytest.raises(CarrlError, match="the exported policy is not the run's own"):
        verify(lambda inputs: policy(**{name: doubled[name] * v for name, v in inputs.items()}), metadata, own, world)
    inputs = exports.inputs("f1tenth", 5)
    found = exports.computed("f1tenth", "npz", inputs)
    assert difference(found, found["action"], found["controls"]) == ""
    assert "actions differ by 0.001" in difference(found, found["action"] + 0.001, found["controls"])
    assert difference(found, found["action"], found["controls"] * 1.01) == "the controls differ"
    assert "shape" in difference(found, found["action"][:4], found["controls"])


def test_a_run_whose_export_differs_leaves_no_file(tmp_path, monkeypatch, capsys):
    run = write_untrained_run(tmp_path / "run")
    monkeypatch.setitem(LAYERS, "relu", lambda layer, arrays, values, xp: values)
    assert main(["export", str(run), "--format", "npz"]) == 2
    assert "the exported policy is not the run's own" in capsys.readouterr().err
    assert not (run / "policy.npz").exists()


def test_one_of_several_seeds_is_chosen(tmp_path, capsys):
    for seed in (3, 4):
        write_untrained_run(tmp_path / f"seed={seed}", seed=seed)
    export = ["export", str(tmp_path), "--format", "npz"]
    assert main(export) == 2
    assert f"'{tmp_path}' has the seeds 3, 4; choose one, such as --seed 3" in capsys.readouterr().err
    assert main([*export, "--seed", "5"]) == 2
    assert "has no seed 5; it has 3, 4" in capsys.readouterr().err
    assert main([*export, "--seed", "4"]) == 0
    assert carrl.load_policy(tmp_path / "seed=4" / "policy.npz").metadata["seed"] == 4


def test_the_same_run_gives_the_same_bytes(exports, tmp_path):
    for kind in ("npz", "c"):
        again = tmp_path / f"policy{ENDINGS[kind]}"
        assert main(["export", str(exports.run("paper")), "--format", kind, "--out", str(again)]) == 0
        assert again.read_bytes() == exports.file("paper", kind).read_bytes()


@pytest.mark.parametrize("name", ['a "car" %s.h', "9 ü.h"])
def test_a_header_may_have_any_name(exports, name, tmp_path, capsys):
    assert main(["export", str(exports.run("paper")), "--format", "c", "--out", str(tmp_path / name)]) == 0
    assert not capsys.readouterr().err
    prefix = "a__car___s" if name.startswith("a") else "policy_9__"
    assert f"void {prefix}_act(" in (tmp_path / name).read_text()


def test_the_command_prints_inputs_and_outputs_with_their_units(exports, tmp_path, capsys):
    out = tmp_path / "car.npz"
    assert main(["export", str(exports.run("f1tenth")), "--format", "npz", "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert f"{out}: seed 0, best network" in printed
    for words in (("previous_rays", "1 x 20", "m"), ("speed", "1", "m/s"), ("rad", "steer: steering angle")):
        assert any(all(word in line for word in words) for line in printed.splitlines())


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--format", "tflite"], "invalid choice: 'tflite'"),
        (["--out", "policy.npz"], "'policy.npz' is no name for the format onnx; it must end in .onnx"),
        (["--format", "npz", "--out", "/nowhere/policy.npz"], "'/nowhere/policy.npz' cannot be written"),
        (["--checkpoint", "first"], "invalid choice: 'first'"),
        (["--seed", "1"], "has no seed 1; it has 0"),
    ],
)
def test_what_cannot_be_is_one_sentence(exports, arguments, says, capsys):
    assert main(["export", str(exports.run("paper")), *arguments]) == 2
    message = capsys.readouterr().err
    assert says in message and message.count("\n") == 1


def test_a_damaged_run_is_one_sentence(tmp_path, capsys):
    run = write_untrained_run(tmp_path / "run")
    (run / "checkpoints" / "best.pt").write_bytes(b"damaged")
    assert main(["export", str(run), "--format", "npz"]) == 2
    assert "is damaged or no checkpoint of CarRL" in capsys.readouterr().err
    assert main(["export", str(tmp_path / "elsewhere")]) == 2
    assert "is not a folder; name a run's" in capsys.readouterr().err


@pytest.mark.parametrize("package", ["onnx", "onnxscript"])
def test_without_its_packages_onnx_says_what_to_install(exports, package, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, package, None)
    assert main(["export", str(exports.run("noisy"))]) == 2
    assert f"ONNX needs {package}, which is not installed; pip install 'carrl[onnx]'" in capsys.readouterr().err


def test_without_a_c_compiler_the_header_is_written_with_a_warning(exports, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    out = tmp_path / "my-car.h"
    assert main(["export", str(exports.run("paper")), "--format", "c", "--out", str(out)]) == 0
    assert "warning: not compared with the run's policy" in capsys.readouterr().err
    assert "static inline void my_car_act(" in out.read_text()


def test_parts_of_one_s_own_are_exported(tmp_path, capsys):
    own = {"network": {"_target_": "own_parts.make_tanh_network", "width": 8}}
    write_untrained_run(tmp_path / "run", "+observation.nearest._target_=own_parts.NearestWall", own=own)
    export = ["export", str(tmp_path / "run"), "--format", "npz"]
    assert main(export) == 2
    assert "add --trust own_parts" in capsys.readouterr().err
    assert main([*export, "--trust", "examples/own_parts/own_parts.py"]) == 0
    metadata = carrl.load_policy(tmp_path / "run" / "policy.npz").metadata
    assert [each["name"] for each in metadata["inputs"]] == ["rays", "nearest"]


GELU = """
from torch import nn
from carrl.algorithms.common.network import QNetwork

def make_network(*, observation_size, action_count, generator):
    return QNetwork(nn.Sequential(nn.Linear(observation_size, 8), nn.GELU(), nn.Linear(8, action_count)))
"""


def test_layers_that_arrays_cannot_have_are_left_to_torch(tmp_path, capsys):
    parts = tmp_path / "gelu_network.py"
    parts.write_text(GELU)
    own = {"network": {"_target_": "gelu_network.make_network"}}
    run = write_untrained_run(tmp_path / "run", own=own, trust=str(parts))
    export = ["export", str(run), "--trust", str(parts), "--format"]
    for kind in ("npz", "c"):
        assert main([*export, kind]) == 2
        assert f"layers that the format {kind} does not know: GELU; choose onnx or torch" in capsys.readouterr().err
    assert main([*export, "torch"]) == 0
    assert carrl.load_policy(run / "policy.pt2")(rays=[3.0] * 7)["action_value"].shape == (3,)


def test_angles_of_the_rays_are_right_to_left(exports):
    angles = carrl.load_policy(exports.file("paper", "npz")).metadata["sensor"]["angles_rad"]
    np.testing.assert_allclose(angles, np.linspace(-math.pi / 2, math.pi / 2, 7), atol=1e-6)
