"""Runs that differ in their seed alone are a group, named by what differs between groups."""

import pytest

from carrl.errors import CheckpointError
from carrl.report.groups import group_runs
from carrl.report.runs import find_runs
from tests.run_folders import CONFIG, LOSSES, write_config, write_hydra, write_run, write_sweep


def groups_below(*roots):
    return group_runs(find_runs(list(roots)), roots)


def labels_below(*roots):
    return [group.label for group in groups_below(*roots)]


def test_seeds_of_a_multirun_are_grouped_by_its_choices_in_the_order_typed(tmp_path):
    write_sweep(tmp_path, {"dqn": [100, 200], "cql": [300, 400], "double_dqn": [500, 600]})
    groups = groups_below(tmp_path)
    assert [group.label for group in groups] == ["loss=dqn", "loss=cql", "loss=double_dqn"]
    assert [group.seeds for group in groups] == [[0, 1]] * 3


def test_without_hydras_notes_the_configuration_names_the_groups(tmp_path):
    for loss in ("dqn", "double_dqn"):
        write_run(tmp_path / loss, loss=LOSSES[loss])
    assert labels_below(tmp_path) == ["loss.double_dqn=true", "loss.double_dqn=false"]


def test_an_option_and_a_value_that_both_differ_are_both_named(tmp_path):
    for loss in ("dqn", "double_dqn"):
        for gamma in (0.9, 0.99):
            folder = tmp_path / f"{loss},{gamma}"
            write_run(folder, loss=LOSSES[loss] | {"gamma": gamma})
            write_hydra(folder, [f"loss={loss}", f"loss.gamma={gamma}", "seed=0"], loss=loss)
    assert labels_below(tmp_path) == [
        "loss=double_dqn, loss.gamma=0.9",
        "loss=double_dqn, loss.gamma=0.99",
        "loss=dqn, loss.gamma=0.9",
        "loss=dqn, loss.gamma=0.99",
    ]


def test_what_one_run_names_and_another_leaves_at_its_default_is_told_of_both(tmp_path):
    write_hydra(write_run(tmp_path / "a"), ["seed=3"], loss="dqn")
    write_hydra(write_run(tmp_path / "b", loss=LOSSES["cql"]), ["loss=cql"], loss="cql")
    assert labels_below(tmp_path) == ["loss=dqn", "loss=cql"]


def test_an_experiment_stands_for_all_that_it_sets(tmp_path):
    write_hydra(write_run(tmp_path / "a"), ["experiment=paper"], experiment="paper", loss="dqn")
    fast = {"loss": LOSSES["double_dqn"], "env": {"num_envs": 16}}
    write_hydra(write_run(tmp_path / "b", **fast), ["experiment=fast"], experiment="fast", loss="double_dqn")
    assert labels_below(tmp_path) == ["experiment=paper", "experiment=fast"]


def test_a_track_file_is_named_by_its_file(tmp_path):
    for name in ("Monza", "Spa"):
        path = f"/home/me/{name}.csv"
        folder = write_run(tmp_path / name, track={"name_or_path": path})
        write_hydra(folder, ["track=file", f"track.name_or_path='{path}'"], track="file")
    assert labels_below(tmp_path) == ["track.name_or_path=Monza.csv", "track.name_or_path=Spa.csv"]


def test_equal_overrides_of_different_configurations_are_told_apart(tmp_path):
    write_hydra(write_run(tmp_path / "before"), ["loss=dqn"], loss="dqn")
    write_hydra(write_run(tmp_path / "after", env={"num_envs": 64}), ["loss=dqn"], loss="dqn")
    assert labels_below(tmp_path) == ["env.num_envs=64", "env.num_envs=8"]


def test_seeds_trained_at_once_and_one_by_one_are_one_group(tmp_path):
    write_config(tmp_path / "at once", trainer=CONFIG["trainer"] | {"seeds": [1, 2]})
    for seed in (1, 2):
        write_run(tmp_path / "at once" / f"seed={seed}", seed)
    write_run(tmp_path / "alone", 0)
    (group,) = groups_below(tmp_path)
    assert (group.label, group.seeds, group.planned) == ("all runs", [0, 1, 2], (0, 1, 2))


def test_only_finished_runs_count_and_each_seed_once(tmp_path):
    first = write_run(tmp_path / "a", 1)
    write_run(tmp_path / "b", 1)
    write_config(tmp_path / "c", 2)
    (group,) = groups_below(tmp_path)
    assert len(group.runs) == 3
    assert [run.folder for run in group.counted] == [first]


def test_groups_stand_in_the_order_of_the_folders_named(tmp_path):
    write_run(tmp_path / "a", loss=LOSSES["dqn"])
    write_run(tmp_path / "b", loss=LOSSES["double_dqn"])
    assert labels_below(tmp_path / "b", tmp_path / "a") == ["loss.double_dqn=true", "loss.double_dqn=false"]


def test_no_run_at_all_is_refused(tmp_path):
    with pytest.raises(CheckpointError, match="no run in"):
        find_runs([tmp_path])


def test_a_folder_without_a_run_is_refused_beside_one_that_has_some(tmp_path):
    write_run(tmp_path / "a")
    (tmp_path / "empty").mkdir()
    for name in ("empty", "missing"):
        with pytest.raises(CheckpointError, match=f"no run in '{tmp_path / name}'; name folders"):
            find_runs([tmp_path / "a", tmp_path / name])
