"""Cars on the workers of a Ray cluster, which the test starts on this machine."""

import copy
import importlib.util
import logging
import math
import os
import signal
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import pytest
import torch

from carrl.cli.main import main
from carrl.cli.text.console import ProgressDisplay
from carrl.errors import ConfigError
from carrl.log import load, read_episodes, verify
from carrl.train.build import build_pipeline
from tests.configs import compose
from tests.processes import addresses_listened_to, descendants, is_running

HAS_RAY = importlib.util.find_spec("ray") is not None
needs_ray = pytest.mark.skipif(not HAS_RAY, reason="ray is not installed; pip install 'carrl[ray]'")
needs_proc = pytest.mark.skipif(sys.platform != "linux", reason="processes are found in /proc")

CARS, STEPS, WORKERS = 8, 16, 2
ROUND = CARS * STEPS
KILLED_AT, FRAMES = 4 * ROUND, 8 * ROUND
OVERRIDES = [
    "collector=ray",
    f"collector.steps_per_batch={STEPS}",
    f"collector.workers={WORKERS}",
    f"env.num_envs={CARS}",
    "track=oval",
    "start.anywhere=true",
    "env.max_steps=40",
    f"trainer.frames={FRAMES}",
    "replay_buffer.batch_size=64",
    "exploration.decay_rate=2e-3",
    "compile=false",
]
LOOPBACK = {"0100007F", "0000000000000000FFFF00000100007F", "00000000000000000000000001000000"}


@dataclass
class Killed:
    """A run one of whose workers was killed."""

    run: Path
    processes: dict[int, str] = field(default_factory=dict)
    workers: list[int] = field(default_factory=list)
    listened: set[str] = field(default_factory=set)
    sigterm: object = None
    networks: list[torch.nn.Module] = field(default_factory=list)
    warnings: str = ""


@pytest.fixture(scope="module")
def killed(tmp_path_factory):
    killed = Killed(tmp_path_factory.mktemp("killed") / "run")

    def kill_a_worker(display, trainer):
        killed.networks.append(copy.deepcopy(trainer.runs[0].network))
        if trainer.frames != KILLED_AT:
            return
        killed.processes = descendants(os.getpid())
        killed.workers = [pid for pid, command in killed.processes.items() if command.startswith("ray::Collector")]
        killed.listened = addresses_listened_to([os.getpid(), *killed.processes])
        killed.sigterm = signal.getsignal(signal.SIGTERM)
        os.kill(killed.workers[0], signal.SIGKILL)

    records: list[str] = []
    handler = logging.Handler()
    handler.emit = lambda record: records.append(record.getMessage())
    logging.getLogger("carrl").addHandler(handler)
    with pytest.MonkeyPatch.context() as patches:
        patches.setattr(ProgressDisplay, "on_round", kill_a_worker)
        assert main(["train", *OVERRIDES, f"hydra.run.dir={killed.run}"]) == 0
    logging.getLogger("carrl").removeHandler(handler)
    killed.warnings = "\n".join(records)
    return killed


@pytest.fixture(scope="module")
def log(killed):
    """Its transitions by car, [CARS, FRAMES / CARS]."""
    transitions = load(killed.run / "train.mcap")
    assert (transitions["car"] == torch.arange(CARS).repeat(FRAMES // CARS)).all()
    return transitions.view(-1, CARS).transpose(0, 1)


@needs_ray
@needs_proc
@pytest.mark.slow
class TestARunWhoseWorkerWasKilled:
    def test_it_goes_on_to_its_end(self, killed):
        assert len(killed.workers) == WORKERS
        assert "A Ray worker was lost" in killed.warnings
        assert verify(killed.run / "train.mcap").transitions == FRAMES

    def test_every_car_begins_a_new_episode_and_no_transition_joins_two(self, log):
        after = KILLED_AT // CARS
        assert (log["step"][:, [0, after]] == 0).all()
        assert (log["step"][:, after - 1] > 0).any()
        goes_on = log["episode"][:, 1:] == log["episode"][:, :-1]
        assert (log["step"][:, 1:] == torch.where(goes_on, log["step"][:, :-1] + 1, 0)).all()
        assert torch.equal(log["next", "observation"][:, :-1][goes_on], log["observation"][:, 1:][goes_on])

    def test_an_episode_ends_but_where_its_last_transition_does(self, killed, log):
        ended = {int(number) for number in log["episode"][log["next", "done"][..., 0]]}
        assert {episode.episode for episode in read_episodes(killed.run / "train.mcap")} == ended
        cut = set(log["episode"][:, KILLED_AT // CARS - 1].tolist()) - ended
        assert cut
        assert cut.isdisjoint(log["episode"][:, KILLED_AT // CARS :].flatten().tolist())

    def test_epsilon_is_equation_4_at_the_env_steps_before_each_batch(self, log):
        batch = torch.arange(FRAMES // CARS) // STEPS
        expected = [0.01 + 0.98 * math.exp(-2e-3 * ROUND * number) for number in batch.tolist()]
        torch.testing.assert_close(log["epsilon"], torch.tensor(expected).expand(CARS, -1))

    def test_workers_act_by_the_network_that_learnt_from_the_batches_before(self, killed, log):
        for number, network in enumerate(killed.networks[:-1], start=1):
            batch = log[:, number * STEPS : (number + 1) * STEPS]
            torch.testing.assert_close(batch["action_value"], network(batch["observation"])[1])
        assert not torch.equal(killed.networks[0](log["observation"])[1], killed.networks[-1](log["observation"])[1])

    def test_no_two_workers_and_no_two_beginnings_draw_the_same(self, log):
        first, second = log["exploratory"].chunk(WORKERS)
        assert not torch.equal(first, second)
        starts = log["pose"][:, [0, KILLED_AT // CARS]].flatten(0, 1)
        assert len(starts.unique(dim=0)) == len(starts)

    def test_all_ports_are_open_to_this_machine_alone(self, killed):
        assert killed.listened
        assert killed.listened <= LOOPBACK

    def test_signals_still_end_a_run_with_everything_saved(self, killed):
        assert killed.sigterm.__qualname__.startswith("StopOnSignals")

    def test_no_process_is_left(self, killed):
        assert any("raylet" in command for command in killed.processes.values())
        ray = {pid: command for pid, command in killed.processes.items() if "ray" in command}
        assert {pid: command for pid, command in ray.items() if is_running(pid)} == {}


CLUSTER = f"""
import ray, sys
from carrl.data.cluster_collector import ray_cluster
with ray_cluster(None, {WORKERS}):
    print(ray.get_runtime_context().gcs_address, flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def cluster_address():
    """Of a cluster that another process keeps open."""
    with subprocess.Popen([sys.executable, "-c", CLUSTER], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        yield process.stdout.readline().decode().strip()
        process.communicate()


@needs_ray
@pytest.mark.slow
def test_a_run_on_a_running_cluster_is_reproducible_and_is_resumed_with_new_episodes(
    cluster_address, log, tmp_path, capsys
):
    address = f"collector.address={cluster_address}"
    assert main(["train", *OVERRIDES, address, f"trainer.frames={KILLED_AT}", f"hydra.run.dir={tmp_path}"]) == 0
    before = load(tmp_path / "train.mcap").view(-1, CARS).transpose(0, 1)
    assert (before == log[:, : KILLED_AT // CARS]).all()

    overrides = ["collector.workers=1", f"trainer.frames={KILLED_AT + ROUND}"]
    assert main(["train", f"resume={tmp_path}", *overrides]) == 2  # as the folder could be a stranger's
    assert "if you trust it, name it again: collector.address=HOST:PORT" in capsys.readouterr().err
    assert main(["train", f"resume={tmp_path}", address, *overrides]) == 0
    assert verify(tmp_path / "train.mcap").transitions == KILLED_AT + ROUND
    after = load(tmp_path / "train.mcap").view(-1, CARS).transpose(0, 1)[:, KILLED_AT // CARS :]
    assert (after["step"][:, 0] == 0).all()
    assert set(after["episode"].flatten().tolist()).isdisjoint(before["episode"].flatten().tolist())
    torch.testing.assert_close(after["epsilon"], log["epsilon"][:, KILLED_AT // CARS :][:, :STEPS])
    assert not torch.equal(after["pose"][:, 0], before["pose"][:, 0])


@needs_ray
def test_an_address_where_nothing_answers_is_refused():
    batches = iter(build_pipeline(compose("collector=ray", "collector.address='127.0.0.1:1'")).source.collector)
    with pytest.raises(ConfigError, match=r"collector.address is '127.0.0.1:1', where no Ray cluster answers"):
        next(batches)


@pytest.mark.parametrize("workers", [0, -1, 3, 9])
def test_cars_that_cannot_be_divided_among_the_workers_are_refused(workers):
    with pytest.raises(ConfigError, match=f"workers is {workers}; it must be at least 1 and divide the 8 cars"):
        build_pipeline(compose("collector=ray", "env.num_envs=8", f"collector.workers={workers}"))


def test_where_ray_is_absent_the_remedy_is_named(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"^collector=ray needs ray; pip install 'carrl\[ray\]'$"):
        build_pipeline(compose("collector=ray"))


def test_several_agents_are_refused():
    with pytest.raises(ConfigError, match="collector=ray trains one replicate"):
        build_pipeline(compose("collector=ray", "trainer.seeds=[0,1]"))


def test_a_batch_without_steps_is_refused():
    with pytest.raises(ConfigError, match="steps_per_batch is 0"):
        build_pipeline(compose("collector=ray", "collector.steps_per_batch=0"))
