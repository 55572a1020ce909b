"""`carrl train`, `evaluate` and `report` as typed."""

import csv
import json
import signal
import subprocess
import sys
import time

import pytest
import yaml
from PIL import Image

from carrl.cli.main import main
from carrl.log import load, read_attachment, read_summary
from carrl.racing import kept_laps
from carrl.report.runs import find_runs
from tests.processes import carrl_command
from tests.racing.laps import oval_lap

FRAMES = 160
TINY = [
    "track=oval",
    "env.num_envs=8",
    f"trainer.frames={FRAMES}",
    "evaluation.interval=80",
    "replay_buffer.batch_size=16",
]


@pytest.fixture(autouse=True, scope="module")
def blank_learning_curves():
    """Here they are drawn as for a user."""


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The folder of a short run."""
    folder = tmp_path_factory.mktemp("runs") / "tiny"
    assert main(["train", *TINY, "seed=5", f"hydra.run.dir={folder}"]) == 0
    return folder


def test_a_run_leaves_its_results_in_one_folder(run):
    assert {path.name for path in run.iterdir()} == {
        ".hydra",
        "checkpoints",
        "evaluations.csv",
        "lap.png",
        "learning_curve.png",
        "metrics.csv",
        "summary.json",
        "train.mcap",
    }
    assert {path.name for path in (run / "checkpoints").iterdir()} == {
        "best.pt",
        "last.pt",
        "state.pt",
        "state-previous.pt",
    }


def test_a_runs_pictures_have_something_on_them(run):
    for name in ("lap.png", "learning_curve.png"):
        with Image.open(run / name) as picture:
            assert min(picture.size) > 300
            assert len(picture.convert("RGB").getcolors(2**24)) > 10


def test_the_summary_has_the_documented_keys(run):
    summary = json.loads((run / "summary.json").read_text())
    assert {"episodes", "frames", "updates", "wall_time_s", "first_lap", "evaluation"} <= summary.keys()
    assert set(summary["evaluation"]) == {
        "lap_completed",
        "lap_reward",
        "lap_steps",
        "lap_time",
        "forward_share",
        "switches_per_100m",
        "near_wall_share",
        "reversals",
        "progress",
    }
    assert (summary["frames"], summary["updates"], summary["seed"]) == (FRAMES, FRAMES - 8, 5)
    with (run / "metrics.csv").open() as file:
        assert len(list(csv.DictReader(file))) == summary["episodes"]


def test_the_log_holds_the_run_its_config_and_its_track(run):
    assert len(load(run / "train.mcap")) == FRAMES
    summary = read_summary(run / "train.mcap")
    assert summary.metadata["seed"] == "5"
    config = yaml.safe_load(read_attachment(run / "train.mcap", "config.yaml"))
    assert config["trainer"]["frames"] == FRAMES
    track = json.loads(read_attachment(run / "train.mcap", "track.json"))
    assert (track["name"], len(track["gates"])) == ("oval", 8)


def test_training_again_with_the_same_seed_gives_the_same_log(run, tmp_path):
    assert main(["train", *TINY, "seed=5", f"hydra.run.dir={tmp_path}"]) == 0
    assert (load(run / "train.mcap") == load(tmp_path / "train.mcap")).all()


def test_a_sweep_leaves_a_folder_for_each_run(tmp_path):
    overrides = ["compile=false", "track=oval", "trainer.frames=16", f"hydra.sweep.dir={tmp_path}"]
    assert main(["train", "-m", *overrides, "loss=dqn,double_dqn"]) == 0
    summaries = sorted(path.parent.name for path in tmp_path.rglob("summary.json"))
    assert len(summaries) == 2
    assert ["loss=double_dqn" in name for name in summaries] == [True, False]


def test_without_a_recorder_there_is_no_log(tmp_path):
    assert main(["train", *TINY, "trainer.frames=16", "recorder=null", f"hydra.run.dir={tmp_path}"]) == 0
    assert not (tmp_path / "train.mcap").exists()
    assert (tmp_path / "summary.json").exists()


def test_a_track_file_trains_by_its_path(real_circuits, tmp_path, monkeypatch):
    folder = tmp_path / "a run's folder"
    (tmp_path / "my track.csv").write_text((real_circuits / "Norisring.csv").read_text())
    monkeypatch.chdir(tmp_path)
    override = "hydra.run.dir='" + str(folder).replace("'", "\\'") + "'"
    assert main(["train", "track=my track.csv", "trainer.frames=16", override]) == 0
    assert json.loads((folder / "summary.json").read_text())["track"] == "my track.csv"


def test_evaluate_prints_one_json_document(run, capsys):
    assert main(["evaluate", str(run), "--track", "oval", "--track", "paper", "--starts", "3", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert [track["track"] for track in document["tracks"]] == ["oval", "paper"]
    oval = document["tracks"][0]
    assert oval["starts"] == len(oval["drives"]) == 3
    assert 0 <= oval["progress"] <= 1
    assert oval["laps_completed"] == sum(drive["lap_completed"] for drive in oval["drives"])


def test_evaluate_drives_the_training_track_with_the_best_network(run, capsys):
    assert main(["evaluate", str(run), "--json"]) == 0
    (track,) = json.loads(capsys.readouterr().out)["tracks"]
    best = json.loads((run / "summary.json").read_text())["evaluation"]
    assert {key: track["drives"][0][key] for key in best} == best


def test_evaluate_has_intervals_and_the_rules_figures_beside_the_policys(run, capsys):
    assert main(["evaluate", str(run), "--track", "oval", "--starts", "4", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    (oval,) = document["tracks"]
    assert (oval["rule"]["laps_completed"], oval["rule"]["collisions"]) == (4, 0)
    low, high = oval["intervals"]["completion"]
    assert low <= oval["laps_completed"] / 4 <= high
    assert oval["collisions"] == sum(drive["collided"] for drive in oval["drives"])
    assert document["all"]["driven_km"] == pytest.approx(oval["driven_km"])
    assert "runs" not in document


def test_a_folder_stands_for_all_circuits_in_it(run, tmp_path, capsys):
    for name, corner in (("one", 60), ("two", 80)):
        corners = [[0, 0], [corner, 0], [corner, 60], [0, 60]]
        drawing = {"corners": corners, "corner_radius": 15, "width": 9}
        (tmp_path / f"{name}.yaml").write_text(yaml.safe_dump(drawing))
    (tmp_path / "notes.txt").write_text("not a circuit")
    assert main(["evaluate", str(run), "--track", str(tmp_path), "--starts", "2"]) == 0
    table, _, lap_times = capsys.readouterr().out.partition("flying laps")
    assert "one.yaml" in table and "two.yaml" in table and "all 2 tracks" in table
    assert table.count("rule") == 3
    assert "one.yaml" in lap_times and "all 2 tracks" not in lap_times


def test_baselines_drive_without_a_run(run, capsys):
    assert main(["evaluate", "--policy", "rule", "--track", "oval", "vehicle.turn_radius=6.0", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["run"], document["policy"]) == ("vehicle.turn_radius=6.0", "rule")
    assert document["all"]["laps_completed"] == 1
    assert main(["evaluate", "--policy", "random", "seed=3", "--json"]) == 0
    drawn = json.loads(capsys.readouterr().out)
    assert main(["evaluate", "--policy", "random", "seed=4", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["tracks"] != drawn["tracks"]
    assert main(["evaluate", str(run), "vehicle=kinematic"]) == 2
    assert "'vehicle=kinematic' has no effect beside a run, which has its own car" in capsys.readouterr().err


def test_follow_the_gap_drives_f1tenths_car(capsys):
    car = ["vehicle=single_track", "vehicle.preset=f1tenth", "sensor.rays=181", "sensor.field_of_view=270"]
    assert main(["evaluate", "--policy", "follow_the_gap", "--track", "oval", "--json", *car]) == 0
    drive = json.loads(capsys.readouterr().out)["tracks"][0]["drives"][0]
    assert drive["lap_completed"]
    assert 3 < drive["mean_speed"] <= 5.01


def test_the_rule_laps_where_the_untrained_network_does_not(run, capsys):
    assert main(["evaluate", str(run), "--policy", "rule", "--starts", "2", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["tracks"][0]["laps_completed"] == 2


def test_evaluate_prints_a_table(run, capsys):
    assert main(["evaluate", str(run), "--policy", "random"]) == 0
    assert "near-wall" in capsys.readouterr().out


def test_evaluate_times_laps_and_compares_them_with_the_limit(run, capsys):
    typed = ["--policy", "rule", "--track", "oval", "--starts", "2", "--laps", "2", "--limit", "oval=20"]
    assert main(["evaluate", str(run), *typed, "--json"]) == 0
    (oval,) = json.loads(capsys.readouterr().out)["tracks"]
    flying = oval["lap_times"]["flying"]
    assert (flying["begun"], flying["counted"], oval["lap_times"]["limit_s"]) == (4, 4, 20)
    times = [lap["time_s"] for drive in oval["drives"] for lap in drive["laps"]]
    assert flying["best_s"] == min(times) and flying["mean_s"] == pytest.approx(sum(times) / 4, abs=1e-3)
    assert flying["share_of_limit"] == pytest.approx(flying["mean_s"] / 20, abs=1e-4)
    assert [drive["lap_time"] for drive in oval["drives"]] == [drive["laps"][-1]["time_s"] for drive in oval["drives"]]


def test_the_tables_of_lap_times_say_which_laps_do_not_count(run, capsys):
    assert main(["evaluate", str(run), "--starts", "2", "--laps", "2", "--limit", "oval=20"]) == 0
    table = capsys.readouterr().out.partition("flying laps: times and mean sectors, s")[2]
    assert "0/2" in table and "4/4" in table and "21.03" in table and "1.051" in table
    assert "laps that were not completed, or in which the car touched a wall, do not count" in table


def test_a_limit_that_is_not_given_is_found_where_it_says_auto(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(kept_laps, "minimum_lap", lambda *_: oval_lap())
    typed = ["evaluate", "--policy", "line", "vehicle=single_track", "--laps", "2", "--limit", "auto"]
    assert main([*typed, "--track", "oval", "--json"]) == 0
    output = capsys.readouterr()
    (oval,) = json.loads(output.out)["tracks"]
    assert oval["lap_times"]["limit_s"] == pytest.approx(oval_lap().lap_time, abs=1e-3)
    assert 1 < oval["lap_times"]["flying"]["share_of_limit"] < 1.25
    assert output.err.count("finding the minimum lap of track 'oval'") == 2  # the limit, and the driver's line
    assert main([*typed, "--limit", "oval=11", "--track", "oval"]) == 0
    output = capsys.readouterr()
    assert "limit of a flying lap: oval 11.00 s" in output.out and "finding" not in output.err


@pytest.mark.parametrize("typed", [["--policy", "line"], ["--policy", "rule", "--limit", "auto"]])
def test_without_casadi_lines_and_limits_name_the_extra(typed, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "casadi", None)
    assert main(["evaluate", *typed, "vehicle=single_track", "--track", "oval"]) == 2
    assert "casadi, which is not installed; pip install 'carrl[racing]'" in capsys.readouterr().err


def test_a_speed_trace_has_the_measured_laps_of_every_start(run, tmp_path, capsys):
    path = tmp_path / "trace.csv"
    assert main(["evaluate", str(run), "--starts", "2", "--speed-trace", str(path), "--json"]) == 0
    (oval,) = json.loads(capsys.readouterr().out)["tracks"]
    with path.open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == sum(drive["lap_steps"] + 1 for drive in oval["drives"])
    assert {row["driver"] for row in rows} == {"seed 5"}
    assert sorted({float(row["start_m"]) for row in rows}) == [round(drive["start"], 3) for drive in oval["drives"]]


@pytest.mark.parametrize(
    ("typed", "reason"),
    [
        (["--limit", "oval"], "--limit is 'oval'; write it as TRACK=SECONDS, such as oval=20.5"),
        (["--limit", "=20"], "--limit is '=20'; write it as TRACK=SECONDS"),
        (["--limit", "oval=fast"], "--limit is 'oval=fast'; write it as TRACK=SECONDS"),
        (["--limit", "oval=20", "--limit", "oval=21"], "--limit is given twice for track 'oval'"),
        (["--limit", "paper=20"], "a limit is given for track 'paper', which is not driven; driven: oval"),
        (["--limit", "oval=-1"], "the limit of track 'oval' is -1.0; it must be a positive number of seconds"),
        (["--speed-trace", "nowhere/trace.csv"], "'nowhere/trace.csv' cannot be written: No such file or directory"),
    ],
)
def test_a_limit_or_trace_that_cannot_be_is_refused(run, typed, reason, capsys):
    assert main(["evaluate", str(run), *typed]) == 2
    error = capsys.readouterr().err
    assert reason in error and "Traceback" not in error


def test_report_lines_up_finished_and_unfinished_runs(run, tmp_path, capsys):
    (tmp_path / "broken" / ".hydra").mkdir(parents=True)
    (tmp_path / "broken" / ".hydra" / "config.yaml").write_text("{}")
    assert main(["report", str(run), str(tmp_path), "--curves", str(tmp_path / "curves.png")]) == 0
    table = capsys.readouterr().out
    assert "| tiny | " in table
    assert "| broken | 0 | unfinished |" in table
    assert (tmp_path / "curves.png").read_bytes().startswith(b"\x89PNG")


def test_several_seeds_leave_a_folder_each_as_if_trained_alone(run, tmp_path, capsys):
    assert main(["train", *TINY, "trainer.seeds=[4..5]", f"hydra.run.dir={tmp_path}"]) == 0
    assert "2 seeds on track oval" in capsys.readouterr().out
    assert {path.name for path in tmp_path.iterdir()} == {".hydra", "checkpoints", "seed=4", "seed=5"}
    ours, alone = tmp_path / "seed=5", run
    assert {path.name for path in ours.iterdir()} == {path.name for path in alone.iterdir()}
    assert (load(ours / "train.mcap") == load(alone / "train.mcap")).all()
    configs = [yaml.safe_load((path / ".hydra" / "config.yaml").read_text()) for path in (ours, alone)]
    assert configs[0] == configs[1]
    assert main(["evaluate", str(tmp_path), "--json", "--starts", "2"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert [each["seed"] for each in document["runs"]] == [4, 5]
    assert document["all"]["starts"] == 4 == len(document["tracks"][0]["drives"])
    assert document["all"]["laps_completed"] == sum(each["all"]["laps_completed"] for each in document["runs"])
    assert main(["evaluate", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert "each run" in out
    assert out.index("flying laps") < out.index("seed 4") < out.index("seed 5") < out.index("each run")
    assert main(["report", str(tmp_path)]) == 0
    table = capsys.readouterr().out.partition("## Runs\n\n")[2]
    assert [line.split(" | ")[0] for line in table.splitlines()[2:4]] == ["| seed=4", "| seed=5"]


def test_runs_are_listed_in_natural_order(tmp_path):
    for name in ("seed=10", "seed=9", "seed=100"):
        (tmp_path / name / ".hydra").mkdir(parents=True)
        (tmp_path / name / ".hydra" / "config.yaml").write_text("{}")
    assert [run.label for run in find_runs([tmp_path])] == ["seed=9", "seed=10", "seed=100"]


def test_runs_of_the_same_name_are_told_apart_by_the_folders_above(tmp_path):
    for name in ("compile=true,loss=dqn/seed=1", "compile=true,loss=double_dqn/seed=1"):
        (tmp_path / name / ".hydra").mkdir(parents=True)
        (tmp_path / name / ".hydra" / "config.yaml").write_text("{}")
    assert [run.label for run in find_runs([tmp_path])] == ["loss=double_dqn", "loss=dqn"]


def test_report_tells_how_far_a_run_is_from_the_best_lap(run, tmp_path, capsys):
    assert main(["report", str(run), "--best-lap", "--bin-size", "0.7"]) == 0
    table, best_lap = capsys.readouterr().out.split("\n\n")
    header, _, row = (line.strip("| ").split(" | ") for line in table.splitlines())
    figures = dict(zip(header, row, strict=True))
    summary = json.loads((run / "summary.json").read_text())["evaluation"]
    assert best_lap.startswith("The best possible lap: 206 steps, forward 78.6%, 3.88 switches / 100 m, 0 reversals.")
    assert float(figures["forward / best"]) == pytest.approx(summary["forward_share"] / 0.786, abs=0.01)
    assert float(figures["switches / best"]) == pytest.approx(summary["switches_per_100m"] / 3.88, abs=0.02)


def test_runs_on_different_tracks_have_no_best_lap_in_common(run, tmp_path, capsys):
    other = tmp_path / "other"
    assert main(["train", *TINY, "track=paper", f"hydra.run.dir={other}"]) == 0
    assert main(["report", str(run), str(other), "--best-lap"]) == 2
    assert "were not trained with the same track, car and sensors" in capsys.readouterr().err


BAD_INPUT = [
    (["train", "sedd=1"], "sedd"),
    (["train", "loss=none"], "loss has no option none; choose one of: advantage_learning, cql, "),
    (["train", "track=nowhere.csv"], "no file of this path"),
    (["train", "track=./"], "this is a folder"),
    (["train", "track=nowhere"], "track has no option nowhere; choose one of: "),
    (["train", "vehicle.speed=-3"], "vehicle.speed is -3"),
    (["train", "optimizer.lr=-1"], "optimizer: Invalid learning rate"),
    (["train", "optimizer.lr=fast"], "optimizer"),
    (["train", "env.num_envs=0"], "env.num_envs is 0"),
    (["train", "threads=0"], "threads is 0"),
    (["train", "compile=maybe"], "compile is 'maybe'"),
    (["train", "device=abacus"], "device is 'abacus'"),
    (["train", "seed=x"], "seed is 'x'"),
    (["train", "trainer.seeds=[1,1]"], "trainer.seeds is [1, 1]"),
    (["train", "trainer.seeds=[0..x]"], "trainer.seeds has '0..x'"),
    (["evaluate", "nothing"], "is not a folder"),
    (["evaluate"], "there is no RUN whose policy could be driven; name its folder, or choose a --policy"),
    (["evaluate", "vehicle=kinematic"], "there is no RUN whose policy could be driven"),
    (
        ["evaluate", "--policy", "rule", "trainer.frames=5"],
        "trainer.frames=5 has no effect on what the rule policy does; leave it out, or set one of: experiment, track,",
    ),
    (["evaluate", "--policy", "rule", "seed=5"], "seed=5 has no effect on what the rule policy does"),
    (["evaluate", "--policy", "rule", "vehicle.spede=5"], "did you mean vehicle.speed?"),
    (["evaluate", "--policy", "rule", "--trust", "mine"], "--trust has no effect without RUN"),
    (
        ["evaluate", "--policy", "rule", "track=oval", "--track", "paper"],
        "track=oval has no effect beside --track; leave one of them out",
    ),
    (
        ["evaluate", "--policy", "follow_the_gap", "vehicle=kinematic"],
        "follow_the_gap tells a car how far to steer and how fast to drive; this one has steer, pedal. Choose vehicle",
    ),
    (
        ["evaluate", "--policy", "line", "vehicle=kinematic"],
        "the line is driven by a car with brush tyres, of which its driver sets the steering angle or rate",
    ),
    (
        ["evaluate", "--policy", "rule", "--limit", "auto", "vehicle=kinematic"],
        "the minimum lap time is that of vehicle=single_track, and this is a Kinematic",
    ),
    (["evaluate", "--policy", "rule", "--limit", "auto", "--limit", "auto"], "--limit auto is given twice"),
    (["report", "nothing"], "no run in 'nothing'"),
    (["fly"], "no verb 'fly'"),
]


@pytest.mark.parametrize(("arguments", "message"), BAD_INPUT, ids=[" ".join(arguments) for arguments, _ in BAD_INPUT])
def test_bad_input_is_one_sentence_and_exit_code_2(arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    output = capsys.readouterr()
    assert message in output.err
    assert output.err.count("\n") == 1
    assert output.out == ""


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        (["--starts", "0"], "starts"),
        (["--starts", "many"], "argument --starts: invalid int value: 'many'; carrl evaluate --help tells more"),
        (
            ["--policy", "rule", "--checkpoint", "last"],
            "--checkpoint has no effect on --policy rule; leave one of them",
        ),
        (["--policy", "gredy"], "argument --policy: invalid choice: 'gredy'"),
        (["--trak", "oval"], "unrecognized arguments: --trak oval; did you mean --track?"),
    ],
)
def test_a_flag_of_evaluate_without_sense_is_one_sentence(run, flags, says, capsys):
    assert main(["evaluate", str(run), *flags]) == 2
    errors = capsys.readouterr().err
    assert says in errors
    assert errors.count("\n") == 1


def test_evaluating_on_a_bad_track_is_refused(run, tmp_path, capsys):
    (tmp_path / "bad.csv").write_text("# x_m,y_m\n1,2\n")
    assert main(["evaluate", str(run), "--track", str(tmp_path / "bad.csv")]) == 2
    assert "no column w_tr_right_m, w_tr_left_m" in capsys.readouterr().err


def test_a_folder_that_cannot_be_written_is_refused(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert main(["train", "trainer.frames=16", f"hydra.run.dir={tmp_path}/file/run"]) == 2
    assert "cannot be written" in capsys.readouterr().err


def test_a_closing_terminal_leaves_a_run_with_everything_saved(tmp_path):
    """SIGINT and SIGTERM: tests/faults."""
    overrides = ["track=oval", "compile=false", f"hydra.run.dir={tmp_path}"]
    command = [*carrl_command(), "train", *overrides]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    deadline = time.monotonic() + 60
    metrics = tmp_path / "metrics.csv"
    while not (metrics.exists() and metrics.stat().st_size) and time.monotonic() < deadline:
        time.sleep(0.05)
    process.send_signal(signal.SIGHUP)
    output, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors.decode()
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert len(load(tmp_path / "train.mcap")) == summary["frames"] > 0
    assert (tmp_path / "checkpoints" / "last.pt").exists()
    assert (tmp_path / "checkpoints" / "state.pt").exists()
    assert f"go on with carrl train resume={tmp_path}" in output.decode()


@pytest.mark.parametrize("flags", [[], ["-m"]], ids=["run", "sweep"])
def test_a_misspelt_key_does_not_wait_for_torch(flags):
    program = f"""
import sys
from carrl.cli.main import main
assert main(["train", *{flags!r}, "sedd=1,2"]) == 2
assert "torch" not in sys.modules
"""
    finished = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert finished.returncode == 0, finished.stderr
    assert finished.stderr.startswith("carrl: ")
    assert "sedd" in finished.stderr


def test_other_actions_observations_and_rewards_are_trained_logged_and_evaluated(tmp_path, capsys):
    own = ["action=steer5", "observation=rays_and_last_action", "reward.proximity=null", "reward.steering.turn=-1"]
    assert main(["train", *TINY, *own, f"hydra.run.dir={tmp_path}"]) == 0
    transitions = load(tmp_path / "train.mcap")
    assert transitions["observation"].shape == (FRAMES, 7 + 5)
    assert transitions["action_value"].shape == (FRAMES, 5)
    assert transitions["next", "reward_terms"].shape == (FRAMES, 3)  # collision, gate, steering
    assert set(transitions["action"].tolist()) == set(range(5))
    metadata = read_summary(tmp_path / "train.mcap").metadata
    assert json.loads(metadata["reward_terms"]) == ["collision", "gate", "steering"]
    assert json.loads(metadata["action_names"]) == ["forward", "left", "right", "half_left", "half_right"]
    assert json.loads(metadata["control_names"]) == ["steer"]
    assert [part[:2] for part in json.loads(metadata["observation"])] == [["rays", 7], ["last_action", 5]]
    turn = transitions["next", "pose"][:, 2] - transitions["pose"][:, 2]
    for action, yaw in enumerate([0, 1 / 7.2, -1 / 7.2, 0.5 / 7.2, -0.5 / 7.2]):
        assert turn[transitions["action"] == action].numpy() == pytest.approx(yaw, abs=1e-5)
    assert main(["log", "show", str(tmp_path / "train.mcap")]) == 0
    laps = []
    for policy in ("greedy", "rule"):
        capsys.readouterr()
        assert main(["evaluate", str(tmp_path), "--policy", policy, "--json"]) == 0
        laps.append(json.loads(capsys.readouterr().out))
    # The rule reads the rays alone, whether it is asked for or stands beside the network.
    assert laps[1]["tracks"][0]["laps_completed"] == 1
