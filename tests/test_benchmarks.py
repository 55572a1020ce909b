"""What `scripts/bench` counts, divides and refuses; nothing is timed here."""

import dataclasses
import importlib.util
import json
import subprocess
import sys
from types import SimpleNamespace

import pytest

from benchmarks import contestants, figures, profiling, recipes, train
from benchmarks.child import ROOT, BenchError, run_child
from benchmarks.contestants import CONTESTANTS, SB3, Contestant
from benchmarks.figures import Measurement
from benchmarks.peers import PEERS
from benchmarks.settings import epsilon_after
from carrl import TrackEnv
from carrl.task.reward import Collision

ONE_CAR, MANY_CARS = SB3.values()


def at_speeds(*speeds):
    return [Measurement(frames=10 * speed, updates=10 * speed - 128, seconds=10.0) for speed in speeds]


def contestant(measured):
    return Contestant("it", "It", frames=1000, seeds=1, train=lambda frames: measured)


def test_ratios_are_of_medians_and_their_range_is_by_round():
    rounds = {"CarRL": at_speeds(900, 2000, 1000), MANY_CARS: at_speeds(300, 1000, 500)}
    row = figures.speed_row("CarRL", rounds, MANY_CARS)
    assert row == ["CarRL", "1,000", "900..2,000", "2.00", "2.00..3.00", "10,000", "9,872", "10.0"]
    assert figures.speed_row(MANY_CARS, rounds, MANY_CARS)[3:5] == ["1.00", "1.00..1.00"]
    assert figures.speed_row("CarRL", rounds, None)[3:5] == ["-", "-"]


def test_the_faster_form_of_stable_baselines_is_the_reference():
    rounds = {ONE_CAR: at_speeds(100, 900, 110), MANY_CARS: at_speeds(200, 190, 210), "CarRL": at_speeds(1, 1, 1)}
    assert figures.fastest(rounds, list(SB3.values())) == MANY_CARS
    assert figures.fastest({"CarRL": at_speeds(1)}, list(SB3.values())) is None


def test_tables_align_and_markdown_has_the_same_cells():
    rows = [["one", "1,000"], ["three", "7"]]
    assert figures.plain_table(["who", "n"], rows) == "who        n\n-----  -----\none    1,000\nthree      7"
    assert figures.markdown_table(["who", "n"], rows).splitlines()[1:] == [
        "| --- | ---: |",
        "| one | 1,000 |",
        "| three | 7 |",
    ]


def test_a_contestant_that_makes_fewer_updates_than_env_steps_is_refused():
    assert contestant(Measurement(1024, 896, 1.0)).measure(1000).updates == 896
    with pytest.raises(BenchError, match=r"1024 env steps of 1000 .* 256 updates"):
        contestant(Measurement(1024, 256, 1.0)).measure(1000)
    with pytest.raises(BenchError, match="500 env steps of 1000"):
        contestant(Measurement(500, 500, 1.0)).measure(1000)


def test_a_run_of_many_seeds_adds_up_frames_and_takes_the_longest_time(tmp_path):
    for seed in range(3):
        folder = tmp_path / f"seed={seed}"
        folder.mkdir()
        (folder / "summary.json").write_text(json.dumps({"frames": 100, "updates": 50, "wall_time_s": 2.0 + seed}))
    assert contestants.read_run(tmp_path, 3) == Measurement(300, 150, 4.0)
    with pytest.raises(BenchError, match=r"has 3 summary\.json"):
        contestants.read_run(tmp_path, 4)


def test_the_first_lap_counts_from_the_start_of_the_process():
    summary = {"start_up_s": 4.0, "first_lap": {"episode": 3, "frame": 2016, "wall_time_s": 6.5}}
    lap = recipes.read_first_lap(summary, 10.6)
    assert lap == recipes.FirstLap(10.5, 4.0, 2016)
    assert recipes.read_first_lap({"first_lap": None}, None) is None
    with pytest.raises(BenchError, match=r"after 10\.5 s, but it was seen at 15\.0 s"):
        recipes.read_first_lap(summary, 15.0)
    with pytest.raises(BenchError, match="has no start_up_s"):
        recipes.read_first_lap({"first_lap": summary["first_lap"]}, 10.6)
    row = recipes.recipe_row("fast", "warm", [lap, None, dataclasses.replace(lap, after_s=12.5)])
    assert row == ["fast", "warm", "11.5 (10.5..12.5)", "4.0 (4.0..4.0)", "2016 (2016..2016)", "2 of 3"]
    assert recipes.recipe_row("fast", "cold", [None])[2:] == ["-", "-", "-", "0 of 1"]


@pytest.mark.parametrize(
    ("laps", "row"),
    [
        ([], None),
        ([True], None),
        ([True, False, True], None),
        ([False, True, True], 1),
        ([True, False, True, True, True], 2),
    ],
)
def test_the_first_lap_is_the_first_one_that_the_next_evaluation_confirms(laps, row):
    assert recipes.confirmed_lap(laps) == row


def test_the_time_of_a_run_counts_for_the_packages_that_are_at_work():
    env = TrackEnv("oval", num_envs=64, seed=0)
    with profiling.Timer() as timer:
        while not {"carrl.sim", "torchrl.envs"} <= timer.seconds.keys() and sum(timer.seconds.values()) < 60:
            env.rollout(50, break_when_any_done=False)
    assert {"carrl.sim", "torchrl.envs"} <= timer.seconds.keys()


def test_what_is_called_from_a_package_counts_for_it():
    frames = []

    class Noting:
        def __mul__(self, weight):
            frames.append(profiling.package_of(sys._getframe()))

    Collision()(SimpleNamespace(outcome=SimpleNamespace(collided=Noting())))
    assert frames == ["carrl.task"]
    assert profiling.package_of(None) == profiling.OTHERS


def test_the_rows_of_a_profile_are_shares_the_largest_first():
    rows = profiling.rows_of({"carrl.log": 1.0, "torchrl.data": 3.0})
    assert rows == [["torchrl.data", "3.00", "75.0%"], ["carrl.log", "1.00", "25.0%"]]
    with pytest.raises(BenchError, match="no code of CarRL was seen at work, only imports"):
        profiling.rows_of({"imports": 1.0})


@pytest.mark.slow
def test_a_training_is_profiled():
    rows = profiling.profile_rows(False, 1, 512)
    assert sum(package.startswith("carrl.") for package, *_ in rows) >= 3  # of those that take no time none is sampled
    assert sum(float(share.rstrip("%")) for *_, share in rows) == pytest.approx(100, abs=2)


def test_the_race_prints_its_table_and_keeps_every_round(tmp_path, monkeypatch, capsys):
    for name, speed in {"compiled": 4000, "sb3-one-car": 300, "sb3-many-cars": 500}.items():
        made = dataclasses.replace(
            CONTESTANTS[name], train=lambda frames, speed=speed: Measurement(frames, frames, frames / speed)
        )
        monkeypatch.setitem(CONTESTANTS, name, made)
    file = tmp_path / "figures.json"
    options = ["--only", "sb3-many-cars,compiled,sb3-one-car", "--rounds", "2", "--markdown", "--json", str(file)]
    assert train.main(options) == 0
    printed = capsys.readouterr().out
    assert (
        "| CarRL, compiled, one seed | 4,000 | 4,000..4,000 | 8.00 | 8.00..8.00 | 100,000 | 100,000 | 25.0 |" in printed
    )
    assert f"against {MANY_CARS}, its fastest form" in printed
    kept = json.loads(file.read_text())["speed"]
    assert kept["reference"] == MANY_CARS
    assert len(kept["rounds"][ONE_CAR]) == 2


def test_a_contestant_that_fails_is_one_sentence_and_exit_code_1(monkeypatch, capsys):
    def fail(frames):
        run_child(["-c", "raise SystemExit('no wheels')"])

    monkeypatch.setitem(CONTESTANTS, "eager", dataclasses.replace(CONTESTANTS["eager"], train=fail))
    assert train.main(["--only", "eager"]) == 1
    assert capsys.readouterr().err.splitlines()[-1].startswith("scripts/bench train: eager: `python -c raise")


BAD_ARGUMENTS = [
    (["--rounds", "0"], "0 is not above 0"),
    (["--rounds", "2.5"], "invalid whole number value: '2.5'"),
    (["--scale", "nan"], "nan is not above 0"),
    (["--only", "rabbit"], "no contestant 'rabbit'; choose from: compiled"),
    (["--recipe-seeds", "-1"], "-1 is not above 0"),
    (["--json", "nowhere/figures.json"], "'nowhere/figures.json' cannot be written"),
    (["--no-race"], "leaves nothing to do"),
    (["--fly"], "unrecognized arguments: --fly"),
]


@pytest.mark.parametrize(("arguments", "message"), BAD_ARGUMENTS, ids=[" ".join(words) for words, _ in BAD_ARGUMENTS])
def test_bad_arguments_are_one_sentence_and_exit_code_2(arguments, message, capsys):
    with pytest.raises(SystemExit) as ended:
        train.main(arguments)
    printed = capsys.readouterr()
    assert ended.value.code == 2
    assert message in printed.err
    assert (printed.err.count("\n"), printed.out) == (1, "")


@pytest.mark.parametrize("arguments", [[], ["fly"]])
def test_an_unknown_verb_is_one_usage_line_and_exit_code_2(arguments):
    script = ROOT / "scripts" / "bench"
    if not script.is_file():
        pytest.skip("scripts/ is only in a checkout")
    done = subprocess.run([str(script), *arguments], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert done.stderr.startswith("usage: scripts/bench VERB")


def test_all_explore_on_the_schedule_of_the_paper():
    assert [epsilon_after(0), round(epsilon_after(10_000), 4)] == [0.99, 0.3705]


@pytest.mark.slow
def test_a_compiled_run_that_could_not_be_compiled_is_refused(monkeypatch):
    monkeypatch.setenv("CXX", "no-such-compiler")
    with pytest.raises(BenchError, match=r"^sac: Updates run eagerly"):
        CONTESTANTS["sac"].measure(320)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "frames", "updates"), [("sb3-one-car", 200, 72), ("sb3-many-cars", 256, 128), ("plain-loop", 200, 73)]
)
def test_a_peer_makes_an_update_for_each_env_step_once_there_is_a_minibatch(name, frames, updates):
    if name in SB3 and importlib.util.find_spec("stable_baselines3") is None:
        pytest.skip("stable_baselines3 is not installed; scripts/bench installs it")
    measured = PEERS[name](200, 0)
    assert (measured.frames, measured.updates) == (frames, updates)
    assert measured.seconds > 0


@pytest.mark.slow
def test_a_peer_trains_in_a_process_of_its_own():
    measured = CONTESTANTS["plain-loop"].measure(200)
    assert (measured.frames, measured.updates) == (200, 73)


def test_the_peers_of_the_table_are_those_that_can_be_run():
    own = [name for name in CONTESTANTS if name not in ("compiled", "eager", "compiled-ten", "eager-ten")]
    assert set(PEERS) == {name for name in own if name in (*SB3, "plain-loop") or name.startswith("sb3-")}
