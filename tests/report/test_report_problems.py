"""What is missing, broken or there twice is named with its reason, and the rest is reported."""

import json
import re

import pytest
import yaml

from carrl.report.findings import find
from tests.run_folders import (
    CONFIG,
    DRIVE,
    LOSSES,
    METRICS_HEADER,
    write_config,
    write_offline_run,
    write_run,
    write_sweep,
)


def problems_below(root):
    return [str(problem) for problem in find([root]).problems]


def test_sound_runs_have_no_problem(tmp_path):
    write_sweep(tmp_path, {"dqn": [100, 200], "cql": [300, 400]})
    write_offline_run(tmp_path / "offline=a", 0)
    write_offline_run(tmp_path / "offline=b", 1)
    assert problems_below(tmp_path) == []


def test_a_run_without_a_summary_is_named_with_how_far_it_came(tmp_path):
    write_run(tmp_path / "a", 0)
    write_config(tmp_path / "b", 1)
    write_run(tmp_path / "c", 2)
    (tmp_path / "c" / "summary.json").unlink()
    with (tmp_path / "c" / "metrics.csv").open("a") as file:
        file.write("3,30")  # killed while it wrote
    assert problems_below(tmp_path) == [
        "unfinished: b: no summary.json, so it crashed, was killed, or still runs; no episode has ended; not counted",
        "unfinished: c: no summary.json, so it crashed, was killed, or still runs; its last episode ended at "
        "frame 200; not counted",
    ]


def test_a_run_stopped_early_is_not_counted(tmp_path):
    write_run(tmp_path / "a", 0, frames=400)
    write_run(tmp_path / "b", 1, frames=400, returns=(-200.0,) * 300)  # as many episodes as it was to have
    write_offline_run(tmp_path / "c", 0, updates=20)
    findings = find([tmp_path])
    assert [str(problem) for problem in findings.problems if problem.kind == "interrupted"] == [
        "interrupted: a: stopped after 400 of 1,000 frames and 2 of 300 episodes; not counted",
        "interrupted: c: stopped after 20 of 500 updates; not counted",
    ]
    assert [len(group.counted) for group in findings.groups] == [1, 0]


BAD_SUMMARIES = {
    "no JSON": "{",
    "a list": "[]",
    "no figures": "{}",
    "no number": json.dumps(
        {"episodes": 1, "frames": "1", "updates": 1, "wall_time_s": 1, "first_lap": None, "evaluation": DRIVE}
    ),
    "half a drive": json.dumps(
        {"episodes": 1, "frames": 1, "updates": 1, "wall_time_s": 1, "first_lap": None, "evaluation": {"progress": 1}}
    ),
    "no finite number": '{"episodes": 1, "frames": NaN, "updates": 1, "wall_time_s": 1}',
    "deep": "[" * 100_000,
}


@pytest.mark.parametrize("content", BAD_SUMMARIES.values(), ids=BAD_SUMMARIES)
def test_a_damaged_summary_is_named_and_the_other_run_is_reported(content, tmp_path):
    write_run(tmp_path / "a", 0)
    write_run(tmp_path / "b", 1)
    (tmp_path / "b" / "summary.json").write_text(content)
    findings = find([tmp_path])
    (problem,) = findings.problems
    assert (problem.kind, problem.what) == ("damaged", "b")
    assert problem.reason.startswith("summary.json is damaged: ")
    assert findings.groups[0].seeds == [0]


@pytest.mark.parametrize(
    "row", ["2,300", "2,300,x,-1", "2,300,nan,-1", "2,,-1,-1", f"2,{10**400},-1,-1", f"2,{2**60},-1,-1"]
)
def test_a_damaged_row_of_a_finished_run_is_named_by_its_number(row, tmp_path):
    write_run(tmp_path / "a", 0)
    (tmp_path / "a" / "metrics.csv").write_text(f"{METRICS_HEADER}0,100,-1,-1\n{row}\n")
    row_with_header = 3
    assert f"damaged: a: metrics.csv is damaged: row {row_with_header} has no" in problems_below(tmp_path)[0]


def test_a_damaged_configuration_is_named(tmp_path):
    write_run(tmp_path / "a", 0)
    (tmp_path / "a" / ".hydra" / "config.yaml").write_text("seed: [")
    write_run(tmp_path / "b", 1)
    (problem,) = problems_below(tmp_path)  # PyYAML's two parsers have words of their own
    assert re.fullmatch(r"damaged: a: .hydra/config.yaml: line [12]: this is not YAML: .*; not counted", problem)


def test_the_same_configuration_and_seed_twice_counts_once(tmp_path):
    write_run(tmp_path / "a", 3, first_lap=100)
    write_run(tmp_path / "b", 3, first_lap=900)
    findings = find([tmp_path])
    assert [str(problem) for problem in findings.problems] == [
        "duplicate: b: the same configuration and seed as a, which is counted instead"
    ]
    assert findings.figures[0]["first_lap_frames"].estimate.value == 100


def test_a_run_that_was_repeated_after_a_crash_is_no_duplicate(tmp_path):
    write_config(tmp_path / "a", 3)
    write_run(tmp_path / "b", 3)
    assert [problem.kind for problem in find([tmp_path]).problems] == ["unfinished"]


def test_seeds_that_only_other_groups_have_are_missing(tmp_path):
    for seed in range(4):
        write_run(tmp_path / f"dqn {seed}", seed)
    for seed in (0, 2):
        write_run(tmp_path / f"cql {seed}", seed, loss=LOSSES["cql"])
    assert problems_below(tmp_path) == ["missing: loss.double_dqn=true: no run with seed 1, 3"]


def test_seeds_that_were_to_be_trained_at_once_are_missing(tmp_path):
    write_config(tmp_path, trainer=CONFIG["trainer"] | {"seeds": ["0..3"]})
    for seed in (0, 1):
        write_run(tmp_path / f"seed={seed}", seed)
    assert problems_below(tmp_path) == ["missing: the runs: no run with seed 2, 3"]


def test_jobs_of_a_multirun_that_left_no_folder_are_missing(tmp_path):
    write_sweep(tmp_path, {"dqn": [100, 200]})
    sweep = {"hydra": {"overrides": {"task": ["loss=dqn,cql", "trainer.seeds=[0..1]"]}}}
    (tmp_path / "multirun.yaml").write_text(yaml.safe_dump(sweep))
    assert problems_below(tmp_path) == [
        f"missing: {tmp_path}: the job loss=cql trainer.seeds=[0..1] has left no folder"
    ]


def test_a_range_of_seeds_in_a_multirun_is_understood(tmp_path):
    for seed in (0, 2):
        write_run(tmp_path / f"seed={seed}", seed)
        (tmp_path / f"seed={seed}" / ".hydra" / "overrides.yaml").write_text(f"- seed={seed}\n")
    sweep = {"hydra": {"overrides": {"task": ["seed=range(0,3)"]}}}
    (tmp_path / "multirun.yaml").write_text(yaml.safe_dump(sweep))
    assert problems_below(tmp_path) == [f"missing: {tmp_path}: the job seed=1 has left no folder"]


@pytest.mark.parametrize("content", ["", "hydra: {overrides: {task: [1]}}", "hydra: {overrides: {task: ['a=[']}}", "{"])
def test_a_damaged_note_of_a_multirun_is_named(content, tmp_path):
    write_run(tmp_path / "a")
    (tmp_path / "multirun.yaml").write_text(content)
    (problem,) = find([tmp_path]).problems
    assert problem.kind == "damaged"
    assert "jobs that never began are not named" in problem.reason


def test_a_group_none_of_whose_runs_finished_is_still_a_group(tmp_path):
    write_run(tmp_path / "a")
    write_config(tmp_path / "b", loss=LOSSES["cql"])
    findings = find([tmp_path])
    labels = [group.label for group in findings.groups]
    assert labels == ["loss.double_dqn=false", "loss.double_dqn=true"]
    assert [group.seeds for group in findings.groups] == [[0], []]
    assert findings.figures[1] == {}
    assert findings.comparisons == []
