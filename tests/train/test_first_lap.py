"""When a greedy lap counts as the first: after an update, and once the next evaluation completes the lap as well."""

from contextlib import ExitStack
from dataclasses import replace

import pytest

from carrl.cli.text.console import print_summaries, print_summary
from carrl.cli.text.many_runs import _figures, _result
from carrl.evaluation.baselines import rule_policy
from carrl.evaluation.results import EvaluationResult
from carrl.evaluation.rollout import rollout_laps
from carrl.report.findings import find
from carrl.report.text import runs_table
from carrl.train.build import build_pipeline
from carrl.train.callbacks import Evaluator
from carrl.train.folder import RunFolder
from carrl.train.objectives import OBJECTIVES
from carrl.train.replicate_run import FirstLap, ReplicateRun, TrainingStatus
from carrl.train.trainer import Trainer
from tests.configs import compose
from tests.data.logs import write_log
from tests.run_folders import write_offline_run, write_run
from tests.worlds import make_world


@pytest.fixture(scope="module")
def lap():
    """A trial that completes its lap, driven by the rule."""
    world = make_world("oval")
    (found,) = rollout_laps(world, world.simulator(world.track), rule_policy)
    return EvaluationResult((found,))


@pytest.fixture(scope="module")
def crash(lap):
    """A trial that ends at a wall."""
    (found,) = lap.rollouts
    return EvaluationResult((replace(found, lap_completed=False, collided=True, progress=0.5),))


@pytest.fixture(scope="module")
def network():
    """Which the trials are said to be of."""
    return build_pipeline(compose("env.num_envs=1", "replay_buffer.capacity=128")).algorithm.networks[0]


def moment(frames, updates):
    return TrainingStatus(frames, updates, 1.0, frames / 100, {"epsilon": 0.1})


EVALUATIONS = {
    "nothing evaluated": ("", None),
    "a lap at the last evaluation": ("..L", None),
    "a lap in passing, twice": ("L.L.", None),
    "two laps running": (".LL", 2),
    "a lap in passing, and later two": ("L..LL.", 4),
    "two laps running, and no more": ("LL...", 1),
    "by luck, before any update": ("ll..", None),
    "by luck, and then two laps that were learnt": ("lLL", 2),
    "by luck, and then one lap that was learnt": ("lL.", None),
}
"""Laps of a network that has been updated, L, or not, l, and other drives; the evaluation that counts, from 1."""


@pytest.mark.parametrize("stopped", [False, True], ids=["in one go", "resumed after each evaluation"])
@pytest.mark.parametrize(("trials", "first"), EVALUATIONS.values(), ids=EVALUATIONS.keys())
def test_a_lap_counts_once_the_next_evaluation_confirms_it(trials, first, stopped, lap, crash, network, tmp_path):
    with RunFolder(tmp_path) as folder:
        run = ReplicateRun(0, network, folder)
        for number, trial in enumerate(trials, start=1):
            run.add_evaluation(crash if trial == "." else lap, moment(1000 * number, 0 if trial == "l" else number))
            if stopped:
                state = run.state_dict()
                run = ReplicateRun(0, network, folder)
                run.load_state_dict(state)
    assert run.first_lap == (None if first is None else FirstLap(0, 1000 * first, 10.0 * first))


def test_agents_side_by_side_confirm_their_own_laps(lap, crash, tmp_path, monkeypatch):
    """Evaluations every 16 steps, and updates from step 128 on, so that the eighth is the first to count."""
    pipeline = build_pipeline(
        compose("trainer.seeds=[0,1]", "env.num_envs=8", "trainer.frames=240", "evaluation.interval=16", "track=oval")
    )
    evaluations = 0

    def trials_of_two(*_):
        nonlocal evaluations
        evaluations += 1
        return [lap, lap if evaluations in (7, 8, 10, 11) else crash]

    monkeypatch.setattr(Evaluator, "drive", trials_of_two)
    with ExitStack() as stack:
        for seed in (0, 1):
            (tmp_path / str(seed)).mkdir()
        trainer = Trainer(pipeline, [stack.enter_context(RunFolder(tmp_path / str(seed))) for seed in (0, 1)])
        trainer.run()
    assert [run.first_lap.frame for run in trainer.runs] == [128, 160]
    assert trainer.summaries()[1]["first_lap"].keys() == {"episode", "frame", "wall_time_s"}


def test_a_network_that_learnt_from_logs_is_driven_once_and_has_no_first_lap(lap, tmp_path, monkeypatch):
    log = write_log(tmp_path / "train.mcap")
    settings = [f"data.path={log}", "data.updates=2", "replay_buffer.batch_size=4", "track=oval"]
    pipeline = build_pipeline(compose("data=log", *settings))
    monkeypatch.setattr(Evaluator, "drive", lambda *_: [lap])
    with RunFolder(tmp_path / "run") as folder:
        trainer = Trainer(pipeline, [folder])
        trainer.run()
    (summary,) = trainer.summaries()
    assert (summary["first_lap"], summary["evaluation"]["lap_completed"]) == (None, True)


def test_a_trial_of_a_search_is_settled_by_a_confirmed_lap_only(lap, network, tmp_path):
    objective = OBJECTIVES["first_lap"]
    with RunFolder(tmp_path) as folder:
        run = ReplicateRun(0, network, folder)
        run.add_evaluation(lap, moment(1000, 1))
        assert (objective.is_settled([run]), objective.value([run], 4000)) == (False, 4000.0)
        run.add_evaluation(lap, moment(2000, 2))
        assert (objective.is_settled([run]), objective.value([run], 4000)) == (True, 1000.0)


def test_a_search_for_lap_times_takes_a_lap_that_does_not_count_for_an_hour_and_more(lap, crash, network, tmp_path):
    objective = OBJECTIVES["lap_time"]
    both = EvaluationResult((*lap.rollouts, *crash.rollouts))
    with RunFolder(tmp_path) as folder:
        run = ReplicateRun(0, network, folder)
        assert objective.value([run], 4000) == 7200.0
        run.add_evaluation(both, moment(1000, 1))
        assert objective.value([run], 4000) == pytest.approx((lap.lap_time + 1.5 * 3600) / 2)
        run.add_evaluation(EvaluationResult(lap.rollouts * 2), moment(2000, 2))
        assert objective.value([run], 4000) == pytest.approx(lap.lap_time)


def summary_of(first_lap, lap_completed, **others):
    drive = {"lap_reward": 400.0, "lap_steps": 230, "forward_share": 0.5, "switches_per_100m": 20.0, "progress": 1.0}
    return {
        **{"seed": 0, "track": "oval", "frames": 1000, "episodes": 9, "updates": 900, "wall_time_s": 3.5},
        **{"first_update_s": 0.5, "first_lap": first_lap, "evaluation": drive | {"lap_completed": lap_completed}},
        **others,
    }


@pytest.mark.parametrize(
    ("first_lap", "lap_completed", "shown"),
    [
        ({"episode": 3, "frame": 500, "wall_time_s": 1.5}, True, "500"),
        (None, True, "not confirmed"),
        (None, False, "none"),
    ],
)
def test_the_terminal_tells_a_lap_that_is_not_confirmed_from_none(first_lap, lap_completed, shown, tmp_path, capsys):
    summary = summary_of(first_lap, lap_completed)
    print_summary(summary, tmp_path)
    print_summaries([summary, summary], tmp_path)
    row, *lines = (line for line in capsys.readouterr().out.splitlines() if shown in line)
    assert "first greedy lap" in row
    assert len(lines) == 2
    assert _figures([summary, summary_of(None, False)])[1] == shown
    assert _result([summary]) == (f"first greedy lap at {shown} frames" if first_lap else "100% of a lap")


def test_the_report_tells_a_lap_that_is_not_confirmed_from_none(tmp_path):
    write_run(tmp_path / "a", seed=0)
    write_run(tmp_path / "b", seed=1, first_lap=None, drive={"lap_completed": True, "progress": 1.0})
    write_run(tmp_path / "c", seed=2, first_lap=None)
    write_offline_run(tmp_path / "d", seed=3)
    findings = find([tmp_path])
    shown = {row[0]: row[3:5] for row in map(_cells, runs_table(findings.runs).splitlines()[2:])}
    assert shown == {"a": ["1", "500"], "b": ["not confirmed"] * 2, "c": ["never"] * 2, "d": ["-"] * 2}


def _cells(line):
    return [cell.strip() for cell in line.strip("|").split("|")]
