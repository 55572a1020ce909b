"""The programs of docs/deploy.md run as they stand there, with exported policies."""

import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

import carrl
from carrl.cli.main import main
from tests.export.policies import Exports
from tests.export.untrained_runs import write_untrained_run

PAGE = Path("docs/deploy.md").read_text()
BLOCKS = {kind: re.findall(rf"^```{kind}\n(.*?)^```", PAGE, re.M | re.S) for kind in ("python", "c")}
BEAMS = np.linspace(-2.35, 2.35, 1080)


@pytest.fixture(scope="module")
def exports(tmp_path_factory):
    return Exports(tmp_path_factory.mktemp("exports"))


class Robot:
    """ROS 2 as far as the node asks for it: what it subscribes to, its timer, and what it has published."""

    def __init__(self, scans):
        self.heard, self.timers, self.published, self._scans = {}, [], [], scans

    def spin(self, node):
        """The timer four times: with each of two scans, without one, and with the second one again."""
        self.drive()
        for scan in (self._scans[0], self._scans[1], None, self._scans[1]):
            self.heard["odom"](
                SimpleNamespace(twist=SimpleNamespace(twist=SimpleNamespace(linear=SimpleNamespace(x=3.0))))
            )
            if scan is not None:
                self.heard["scan"](self.message(scan))
            self.drive()

    def drive(self):
        for call in self.timers:
            call()

    @staticmethod
    def message(scan):
        return SimpleNamespace(angle_min=BEAMS[0], angle_increment=BEAMS[1] - BEAMS[0], ranges=scan.tolist())

    def modules(self):
        robot = self

        class Node:
            def __init__(self, name):
                assert name == "driver"

            def create_publisher(self, kind, topic, depth):
                assert topic == "drive"
                return SimpleNamespace(publish=lambda command: robot.published.append(vars(command.drive)))

            def create_subscription(self, kind, topic, callback, depth):
                robot.heard[topic] = callback

            def create_timer(self, period, callback):
                robot.period = period
                robot.timers.append(callback)

        def command():
            return SimpleNamespace(drive=SimpleNamespace(steering_angle=0.0, speed=0.0))

        parts = {
            "rclpy": {"init": lambda: None, "spin": self.spin},
            "rclpy.node": {"Node": Node},
            "ackermann_msgs": {},
            "ackermann_msgs.msg": {"AckermannDriveStamped": command},
            "nav_msgs": {},
            "nav_msgs.msg": {"Odometry": object},
            "sensor_msgs": {},
            "sensor_msgs.msg": {"LaserScan": object},
        }
        for name, values in parts.items():
            module = ModuleType(name)
            vars(module).update(values)
            yield name, module


@pytest.mark.slow
def test_the_ros_node_commands_what_the_policy_does(exports, monkeypatch):
    policy = exports.file("f1tenth", "onnx")
    scans = [np.random.default_rng(seed).uniform(0.3, 12.0, 1080).astype(np.float32) for seed in (0, 1)]
    robot = Robot(scans)
    for name, module in robot.modules():
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setattr(sys, "argv", ["drive.py", str(policy)])
    (node,) = (block for block in BLOCKS["python"] if "rclpy" in block)
    exec(compile(node, "drive.py", "exec"), {"__name__": "__main__"})
    assert robot.period == 0.04
    driver = carrl.load_policy(exports.file("f1tenth", "npz")).driver()
    first, second, third = (driver(rays=scans[index][::54], speed=3.0)["controls"] for index in (0, 1, 1))
    expected = [(0, 0), first, second, (0, 0), third]
    found = [(command["steering_angle"], command["speed"]) for command in robot.published]
    np.testing.assert_allclose(found, expected, atol=1e-5)
    with pytest.raises(SystemExit, match="does not see in all directions"):
        robot.heard["scan"](SimpleNamespace(angle_min=-1.57, angle_increment=0.01, ranges=[1.0] * 314))


def test_the_c_program_prints_the_actions_of_the_policy(tmp_path):
    if shutil.which("cc") is None:
        pytest.skip("there is no C compiler")
    run = write_untrained_run(tmp_path / "run", "experiment=smooth", seed=2)  # which takes all three actions in turn
    for kind, name in (("c", "policy.h"), ("npz", "policy.npz")):
        assert main(["export", str(run), "--format", kind, "--out", str(tmp_path / name)]) == 0
    (program,) = BLOCKS["c"]
    (tmp_path / "drive.c").write_text(program)
    (command,) = re.findall(r"^    (cc .*)$", PAGE, re.M)
    subprocess.run(command.split(), cwd=tmp_path, check=True)
    scans = np.random.default_rng(0).uniform(0, 20, (200, 7)).astype(np.float32)
    lines = "\n".join(" ".join(map(str, scan)) for scan in scans)
    printed = subprocess.run([tmp_path / "a.out"], input=lines, capture_output=True, text=True, check=True).stdout
    driver = carrl.load_policy(tmp_path / "policy.npz").driver()
    expected = [(found["action"], *found["controls"]) for found in (driver(rays=scan) for scan in scans)]
    assert len({action for action, _ in expected}) == 3
    np.testing.assert_allclose([list(map(float, line.split())) for line in printed.splitlines()], expected, atol=1e-5)


def test_the_python_of_the_page_runs(exports, tmp_path, monkeypatch):
    (tmp_path / "policy.npz").write_bytes(exports.file("paper", "npz").read_bytes())
    monkeypatch.chdir(tmp_path)
    (code,) = (block for block in BLOCKS["python"] if "load_policy" in block)
    names = {}
    exec(code, names)
    assert names["driver"](rays=[2.0] * 7)["controls"].shape == (1,)


def test_the_page_says_how_large_the_policy_of_smooth_is(exports):
    metadata = carrl.load_policy(exports.file("smooth", "npz"))
    with np.load(exports.file("smooth", "npz")) as arrays:
        weights = sum(arrays[name].size for name in arrays.files if name.startswith("linear"))
    assert f"has {weights:,} weights, {weights * 4 / 1000:.1f} kB" in PAGE
    assert [each["kind"] for each in metadata.metadata["network"]] == ["linear", "relu"] * 2 + ["linear"]
