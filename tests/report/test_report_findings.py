"""What a report tells of groups and pairs of groups."""

import json

import pytest

from carrl.errors import ConfigError
from carrl.report.curve_figures import lap_profiles, return_curves, score_profiles
from carrl.report.document import as_json, groups_csv, runs_csv
from carrl.report.findings import find
from carrl.report.measures import FINAL_RETURN
from carrl.report.text import report_text, runs_table
from tests.run_folders import LOSSES, write_config, write_hydra, write_offline_run, write_run, write_sweep


def comparison_of(findings, key):
    return next(each for each in findings.comparisons if each.measure.key == key)


def test_a_group_that_laps_sooner_is_said_to(tmp_path):
    write_sweep(tmp_path, {"dqn": [500, 600, 700, 800, None], "double_dqn": [100, 150, 200, 250, 300]})
    findings = find([tmp_path])
    laps = comparison_of(findings, "first_lap_frames")
    assert (laps.first, laps.second, laps.probability.value, laps.p) == (
        "loss=double_dqn",
        "loss=dqn",
        1.0,
        pytest.approx(2 / 252),
    )
    assert laps.significant
    assert (
        "- significant: loss=double_dqn laps after fewer frames than loss=dqn (probability of improvement 1.00 "
        "[1.00, 1.00], p = 0.0079)\n"
    ) in report_text(findings)


def test_a_run_that_never_lapped_counts_in_the_mean_as_far_as_it_went_and_is_marked(tmp_path):
    write_sweep(tmp_path, {"dqn": [300, 500, None, None], "double_dqn": [100, 200, 300, 400]})
    findings = find([tmp_path])
    figure = findings.figures[0]["first_lap_frames"]
    assert (figure.estimate.value, figure.never) == (750, 2)  # of 300, 500, 1000, 1000 the middle two
    assert "| loss=dqn | 4 | 2 of 4 | ≥ 750 [" in report_text(findings)


def test_smoothness_is_that_of_laps(tmp_path):
    write_run(tmp_path / "a", 0, drive={"switches_per_100m": 30.0})
    write_run(tmp_path / "b", 1, first_lap=None, drive={"switches_per_100m": 0.0})
    figures = find([tmp_path]).figures[0]
    assert (figures["switches_per_100m"].estimate.value, figures["switches_per_100m"].runs) == (30.0, 1)
    assert figures["progress"].estimate.value == 0.75


def test_clear_differences_between_few_runs_are_not_significant_and_the_report_says_why(tmp_path):
    write_sweep(tmp_path, {"dqn": [500, 600, 700], "double_dqn": [100, 200, 300]})
    findings = find([tmp_path])
    laps = comparison_of(findings, "first_lap_frames")
    assert laps.probability.low == 1.0
    assert not laps.significant
    assert findings.runs_needed == 4  # 2 of 70 ways
    assert "train at least 4 seeds of each group" in report_text(findings)


def test_many_pairs_need_more_runs(tmp_path):
    laps = [100, 200, 300, 400]
    write_sweep(tmp_path, {"dqn": laps, "double_dqn": laps, "cql": laps})
    assert find([tmp_path]).runs_needed == 5  # 3 * 2 / 70 is above 0.05, 3 * 2 / 252 below


def test_holms_correction_counts_the_pairs_of_a_measure(tmp_path):
    write_sweep(tmp_path, {"dqn": [1, 2, 3, 4, 5], "double_dqn": [11, 12, 13, 14, 15], "cql": [21, 22, 23, 24, 25]})
    laps = [each for each in find([tmp_path]).comparisons if each.measure.key == "first_lap_frames"]
    assert [each.p for each in laps] == pytest.approx([2 / 252] * 3)
    assert [each.corrected_p for each in laps] == pytest.approx([6 / 252] * 3)


def test_seconds_of_seeds_trained_at_once_are_not_compared(tmp_path):
    write_sweep(tmp_path, {"dqn": [500, 600], "double_dqn": [100, 200]})
    assert "first_lap_s" not in {each.measure.key for each in find([tmp_path]).comparisons}


def test_seconds_of_runs_trained_alone_are_compared(tmp_path):
    for loss, laps in {"dqn": (500, 600), "cql": (100, 200)}.items():
        for seed, lap in enumerate(laps):
            write_run(tmp_path / f"{loss} {seed}", seed, lap, loss=LOSSES[loss])
    assert comparison_of(find([tmp_path]), "first_lap_s").probability.value == 1.0


def test_returns_are_compared_where_the_same_is_paid_for(tmp_path):
    for turn in (0, -8):
        for seed in (0, 1):
            reward = {"collision": {"weight": -200.0}, "gate": {"weight": 50.0}, "steering": {"turn": turn}}
            write_run(tmp_path / f"{turn} {seed}", seed, reward=reward)
    keys = {each.measure.key for each in find([tmp_path]).comparisons}
    assert "final_return" not in keys
    assert "lap_reward" in keys  # the paper's, without what turns cost


def test_lap_rewards_are_compared_where_the_papers_weights_are_the_same(tmp_path):
    for gate in (50.0, 2.0):
        for seed in (0, 1):
            reward = {"collision": {"weight": -200.0}, "gate": {"weight": gate}}
            write_run(tmp_path / f"{gate} {seed}", seed, reward=reward)
    assert "lap_reward" not in {each.measure.key for each in find([tmp_path]).comparisons}


def write_grid(root):
    for loss in ("dqn", "cql"):
        for gamma in (0.9, 0.99):
            folder = root / f"{loss},{gamma}"
            write_hydra(folder, [f"loss={loss}", f"loss.gamma={gamma}"], loss=loss)
            for seed in (0, 1):
                write_run(folder / f"seed={seed}", seed, loss=LOSSES[loss] | {"gamma": gamma})


def test_pairs_that_differ_in_two_choices_are_not_compared(tmp_path):
    write_grid(tmp_path)
    pairs = {(each.first, each.second) for each in find([tmp_path]).comparisons}
    assert len(pairs) == 4  # of 6


def test_a_baseline_is_compared_with_all_others(tmp_path):
    write_grid(tmp_path)
    baseline = "loss=dqn, loss.gamma=0.9"
    pairs = {frozenset((each.first, each.second)) for each in find([tmp_path], baseline).comparisons}
    assert len(pairs) == 3
    assert all(baseline in pair for pair in pairs)
    with pytest.raises(ConfigError, match=r"choose a baseline of: loss=cql, loss\.gamma=0\.9; "):
        find([tmp_path], "loss=dqn")


def test_of_many_groups_each_is_compared_with_the_first(tmp_path):
    for index in range(8):
        for seed in (0, 1):
            write_run(tmp_path / f"{index} {seed}", seed, network={"hidden_sizes": [index + 1]})
    findings = find([tmp_path])
    assert len({(each.first, each.second) for each in findings.comparisons}) == 7  # not 28


def test_a_curve_holds_its_value_until_the_next_episode_ends(tmp_path):
    write_run(tmp_path / "a", 0, returns=(-200.0, -100.0))  # at frames 100 and 200 of 1,000
    write_run(tmp_path / "b", 1, returns=(-300.0, -100.0, 300.0))
    (curve,) = return_curves(find([tmp_path]).groups)
    at = dict(zip(curve.points.tolist(), curve.band.value.tolist(), strict=True))
    assert min(at) == 100
    assert max(at) == 1000
    assert (at[100], at[195], at[200], at[295], at[300], at[1000]) == (-250, -250, -100, -100, 100, 100)


def test_profiles_are_shares_of_runs(tmp_path):
    for seed, lap in enumerate((250, 500, None, None)):
        write_run(tmp_path / str(seed), seed, lap, returns=(100.0 * seed,))
    groups = find([tmp_path]).groups
    (laps,) = lap_profiles(groups)
    share = dict(zip(laps.points.tolist(), laps.band.value.tolist(), strict=True))
    assert (share[245], share[250], share[500], share[1000]) == (0, 0.25, 0.5, 0.5)
    (scores,) = score_profiles(groups, FINAL_RETURN)
    above = scores.band.value
    assert (above[0], above[-1]) == (1, 0)
    assert scores.band.value[scores.points.searchsorted(150)] == 0.5  # 200 and 300 are


def test_runs_that_learnt_from_logs_are_compared_by_how_they_drive(tmp_path):
    for loss_index, share in enumerate((0.5, 0.6)):
        for seed in (0, 1):
            folder = tmp_path / f"{loss_index} {seed}"
            write_offline_run(folder, seed, forward_share=share)
            write_config(folder, seed, data={"path": f"{loss_index}.mcap", "updates": 500})
    findings = find([tmp_path])
    assert findings.problems == []
    assert {each.measure.key for each in findings.comparisons} == {
        "progress",
        "lap_reward",
        "switches_per_100m",
        "forward_share",
    }
    assert comparison_of(findings, "forward_share").first == "data.path=1.mcap"
    assert return_curves(findings.groups) == lap_profiles(findings.groups) == []


def test_a_figure_does_not_depend_on_what_else_is_reported(tmp_path):
    write_sweep(tmp_path / "more", {"dqn": [100, 250, 300, 700, 800], "cql": [100, 200, 300, 400, 500]})
    alone = find([tmp_path / "more" / "loss=dqn"]).figures[0]
    together = find([tmp_path / "more"]).figures[0]
    assert alone == together


def test_the_document_says_never_and_unknown_as_null(tmp_path):
    write_run(tmp_path / "a", 0, first_lap=None)
    document = json.loads(as_json(find([tmp_path])))
    (run,) = document["runs"]
    assert (run["counted"], run["lapped"], run["first_lap_frames"], run["progress"]) == (True, False, None, 0.5)
    (group,) = document["groups"]
    assert group["figures"]["first_lap_frames"] == {"value": 1000.0, "low": None, "high": None, "runs": 1, "never": 1}


def test_tables_for_machines_have_a_row_for_each_run_and_group(tmp_path):
    write_sweep(tmp_path, {"dqn": [100, None], "cql": [300, 400]})
    write_config(tmp_path / "loss=dqn" / "seed=7", 7, loss=LOSSES["dqn"])
    findings = find([tmp_path])
    runs = [line.split(",") for line in runs_csv(findings).splitlines()]
    assert len(runs) == 1 + 5
    assert runs[0][:6] == ["run", "folder", "group", "seed", "state", "counted"]
    assert sum("unfinished" in row for row in runs) == 1
    header, dqn, cql = (line.split(",") for line in groups_csv(findings).splitlines())
    assert dict(zip(header, dqn, strict=True))["first_lap_frames_never"] == "1"
    assert dict(zip(header, cql, strict=True))["first_lap_frames"] == "350.0"


def test_names_that_could_steer_a_terminal_are_printed_escaped(tmp_path):
    write_run(tmp_path / "a\x1b[2J|b", 0)
    write_config(tmp_path / "c\x1b[2J", 1)
    text = report_text(find([tmp_path]))
    assert "\x1b" not in text
    assert r"a\x1b[2J\|b" in text


def test_runs_of_cars_with_pedals_are_compared_by_speed_and_steering(tmp_path):
    style = {"forward_share": None, "switches_per_100m": None, "reversals": None}
    for seed in range(3):
        for name, speed in (("dqn", 20.0), ("double_dqn", 30.0)):
            folder = tmp_path / name / str(seed)
            write_run(
                folder, seed, drive=style | {"mean_speed": speed + seed, "steering_change": 0.1}, loss=LOSSES[name]
            )
            drop_nones(folder)
    findings = find([tmp_path])
    assert {figure for figures in findings.figures for figure in figures} >= {"mean_speed", "steering_change"}
    comparison = comparison_of(findings, "mean_speed")
    assert (comparison.first, comparison.probability.value) == ("loss.double_dqn=true", 1.0)
    table = runs_table(findings.runs)
    assert "mean speed, m/s | steering change" in table and "forward share" not in table
    assert "| 32.0 | 0.100 |" in table
    assert "forward" not in groups_csv(findings).splitlines()[0]


def drop_nones(folder):
    """Leaves what a drive does not have out of the run's summary, as a run does."""
    path = folder / "summary.json"
    summary = json.loads(path.read_text())
    summary["evaluation"] = {name: value for name, value in summary["evaluation"].items() if value is not None}
    path.write_text(json.dumps(summary))


def test_lap_times_are_compared_where_laps_count_and_shown_beside_runs_of_older_versions(tmp_path):
    for seed in range(3):
        for name, seconds in (("dqn", 24.0), ("double_dqn", 23.0)):
            write_run(tmp_path / name / str(seed), seed, drive={"lap_time": seconds + seed / 10}, loss=LOSSES[name])
    findings = find([tmp_path])
    comparison = comparison_of(findings, "lap_time")
    assert (comparison.first, comparison.probability.value) == ("loss.double_dqn=true", 1.0)
    assert findings.figures[0].keys() >= {"lap_time", "forward_share"}
    write_run(tmp_path / "older", 7)
    write_run(tmp_path / "crashed", 8, first_lap=None, drive={"lap_time": None})
    header, _, *rows = runs_table(find([tmp_path]).runs).splitlines()
    column = header.split(" | ").index("lap, s")
    times = sorted(row.split(" | ")[column] for row in rows)
    assert times == ["-", "-", "23.00", "23.10", "23.20", "24.00", "24.10", "24.20"]


def test_a_run_of_an_older_version_alone_has_no_column_of_lap_times(tmp_path):
    write_run(tmp_path / "older", 7)
    assert "lap, s" not in runs_table(find([tmp_path]).runs)
