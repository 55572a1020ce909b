"""What `scripts/bench sim` counts, divides and refuses; speeds are not judged here."""

import cProfile
import importlib.util
import json
import math
import stat
from dataclasses import fields

import pytest
import torch

from benchmarks import sim, sim_cells, sim_limit, sim_profile, sim_tables, sim_traffic
from benchmarks.child import BenchError
from benchmarks.sim_cells import Cell, Course, drive_course, drive_for
from benchmarks.sim_drives import CONTESTANTS, Contestant, LeftOutError, put_back, random_stations
from benchmarks.sim_tables import Row
from carrl.sim.others import CarContact
from carrl.sim.sensor import Sensor
from carrl.sim.simulator import CarState, Outcome, Simulator
from carrl.sim.vehicle import Vehicle
from carrl.task.action import steer3
from carrl.tracks.track import Track

needs_vmas = pytest.mark.skipif(
    importlib.util.find_spec("vmas") is None, reason="vmas is not installed; scripts/bench installs it"
)
FAST = Row("simulator", "paper", "fast, paper", {1: [10.0, 20.0, 30.0], 64: [900.0, 2000.0, 1000.0]})
SLOW = Row("vmas", "paper", "slow, paper", {1: [1.0, 1.0, 1.0], 64: [300.0, 1000.0, 500.0], 256: [2.0, 2.0, 2.0]})
ELSEWHERE = Row("simulator", "spa", "fast, spa", {64: [450.0, 500.0, 500.0]})


def test_every_row_is_taken_at_the_number_of_cars_with_the_highest_median():
    assert (FAST.best_cars, SLOW.best_cars) == (64, 64)
    assert SLOW.best == [300.0, 1000.0, 500.0]


def test_numbers_of_cars_that_were_not_driven_are_dashes():
    header, lines = sim_tables.sizes_table([FAST, SLOW])
    assert header == ["car-steps/s with", "1 car", "64", "256"]
    assert lines == [["fast, paper", "20", "1,000", "-"], ["slow, paper", "1", "500", "2"]]


def test_ratios_are_of_medians_and_their_range_is_by_round():
    rows = [FAST, ELSEWHERE, SLOW]
    references = [
        sim_tables.against_all("times slow", rows, SLOW.best),
        sim_tables.against_first_track("times paper", rows, "paper"),
    ]
    header, lines = sim_tables.best_table(rows, references)
    assert header == ["at its best", "cars", "car-steps/s", "min..max", "times slow", "times paper"]
    assert lines[0] == ["fast, paper", "64", "1,000", "900..2,000", "2.00 (2.00..3.00)", "-"]
    assert lines[1] == ["fast, spa", "64", "500", "450..500", "1.00 (0.50..1.50)", "0.50 (0.25..0.50)"]
    assert lines[2][4:] == ["1.00 (1.00..1.00)", "-"]


def test_only_cars_that_collided_go_back_whatever_the_state_holds():
    shapes = [(3, 3) if field.name == "state" else (3,) for field in fields(CarState)]
    start, now = (CarState(*(torch.full(shape, value) for shape in shapes)) for value in (1, 2))
    after = put_back(torch.tensor([False, True, False]), start, now)
    assert after.pose[:, 0].tolist() == after.next_gate.tolist() == [2, 1, 2]
    assert put_back(torch.zeros(3, dtype=torch.bool), start, now) is now


def test_cars_begin_all_round_the_track_and_everyone_at_the_same_places():
    track = Track.load("paper")
    stations = random_stations(track, 1000)
    assert stations.min() < 0.01 * track.length < 0.99 * track.length < stations.max() < track.length
    assert torch.equal(stations, random_stations(track, 1000))


def test_the_clock_runs_for_as_long_as_it_is_told_and_at_least_one_call():
    steps, seconds, call_s = drive_for(lambda: 5, 0.01)
    assert (steps % 5, seconds >= 0.01, call_s) == (0, True, pytest.approx(seconds / (steps / 5)))
    assert drive_for(lambda: 5, 1e-9)[0] == 5


def test_fewer_cars_foretell_which_numbers_take_too_long(monkeypatch):
    calls = iter([(10, 1.0, 0.5), (40, 2.0, 2.0), (1, 1.0, 1.0)] * 2)
    monkeypatch.setattr(sim_cells, "drive_for", lambda drive, seconds: (0, 0, 0) if seconds < 1 else next(calls))
    made = []
    contestant = Contestant("it", "It", lambda track, cars: made.append(cars), paper_only=True)
    cells = drive_course(contestant, Course(["no such track"], [1, 4, 16], 1.0))
    assert cells == [Cell("paper", 1, 10, 1.0), Cell("paper", 4, 40, 2.0)]
    assert made == [1, 4]


@pytest.mark.parametrize("name", list(CONTESTANTS))
def test_every_contestant_makes_the_car_steps_that_it_counts(name):
    try:
        cells = drive_course(CONTESTANTS[name], Course(["paper"], [1, 3], 1e-9))
    except LeftOutError as reason:
        pytest.skip(str(reason))
    one_call = 8 if name == "collector" else 1
    assert [(cell.cars, cell.steps) for cell in cells] == [
        (cars, cars * one_call) for cars in ([1] if CONTESTANTS[name].one_car else [1, 3])
    ]
    assert all(cell.seconds > 0 for cell in cells)


@needs_vmas
def test_the_car_in_vmas_moves_and_sees_as_ours_does():
    from benchmarks.sim_vmas import make_road

    track, vehicle, sensor = Track.load("paper"), Vehicle(), Sensor()
    simulator = Simulator(track, vehicle, sensor)
    start = simulator.start(random_stations(track, 6))
    env = make_road(track.walls, start.pose, vehicle, sensor)
    action, turn = torch.tensor([0, 1, 2, 0, 1, 2]), torch.tensor([[0.0], [1.0], [-1.0]] * 2)
    outcome = simulator.step(start, steer3().controls(action))
    (observation,), (reward,), done, _ = env.step([turn])
    assert not outcome.collided.any() | done.any()
    torch.testing.assert_close(env.agents[0].state.pos, outcome.cars.pose[:, :2], atol=1e-4, rtol=0)
    torch.testing.assert_close(observation, outcome.ranges / sensor.max_range, atol=1e-4, rtol=0)
    assert reward.tolist() == [0.0] * 6


@needs_vmas
def test_a_car_in_vmas_goes_back_to_its_start_when_it_meets_a_wall():
    from benchmarks.sim_vmas import make_road

    wall = torch.tensor([[[5.0, -9.0], [5.0, 9.0]]])
    start = torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.0, math.pi]])
    env = make_road(wall, start, Vehicle(), Sensor())
    forward = [torch.zeros(2, 1)]
    done = [env.step(forward)[2].tolist() for _ in range(5)]
    assert done == [[False, False]] * 4 + [[True, False]]  # It is one step away from passing through the wall.
    assert env.agents[0].state.pos.tolist() == pytest.approx(torch.tensor([[0.0, 0.0], [-5.0, 0.0]]), abs=1e-4)


@needs_vmas
def test_a_thinned_out_road_keeps_both_of_its_sides_closed():
    from benchmarks.sim_vmas import thin_out

    walls = Track.load("paper").walls
    few = thin_out(walls, 64)
    assert few.shape == (64, 2, 2)
    for side in few.view(2, 32, 2, 2):
        assert torch.equal(side[:, 1], side[:, 0].roll(-1, dims=0))
    assert torch.equal(thin_out(walls, len(walls)), walls)


def test_the_figure_of_the_hand_written_program_is_that_of_the_processors_time(tmp_path):
    lines = [
        "N=4096 walls=64 threads=1 poly_soa    9.000 Mcar-steps/s (cpu time)    8.900 (wall)",
        "N=4096 walls=256 threads=1 brute_soa    2.213 Mcar-steps/s (cpu time)    2.213 (wall)",
        "N=4096 walls=256 threads=1 poly_soa     3.723 Mcar-steps/s (cpu time)    3.500 (wall)",
    ]
    program = tmp_path / "limit"
    program.write_text(
        "#!/bin/sh\n[ \"$*\" = '4096 1.0 1' ] || exit 1\n" + "".join(f"echo '{line}'\n" for line in lines)
    )
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    assert sim_limit.measure_limit(program) == pytest.approx(3.723e6)
    program.write_text("#!/bin/sh\necho no wheels >&2; exit 1\n")
    with pytest.raises(BenchError, match="failed: no wheels"):
        sim_limit.measure_limit(program)
    with pytest.raises(BenchError, match="printed no figure for 256 walls"):
        sim_limit.read_limit(lines[1])
    with pytest.raises(BenchError, match="cannot be run: Permission denied"):
        program.chmod(0o600)
        sim_limit.measure_limit(program)


STEP, RESET, SENSE, WHERE, ADD = (
    ("/x/torchrl/envs/common.py", 1, "step_and_maybe_reset"),
    ("/x/torchrl/envs/common.py", 2, "maybe_reset"),
    ("/carrl/checkout/carrl/sim/simulator.py", 3, "sense"),
    ("/x/tensordict/_td.py", 4, "where"),
    ("~", 0, "add"),
)
PROFILE = {
    STEP: (1, 1, 1.0, 10.0, {}),
    RESET: (1, 1, 0.5, 4.0, {STEP: (1, 1, 0.5, 4.0)}),
    SENSE: (2, 2, 2.5, 4.5, {STEP: (1, 1, 1.5, 2.5), RESET: (1, 1, 1.0, 2.0)}),
    WHERE: (2, 2, 3.97, 3.97, {STEP: (1, 1, 3.97, 3.97)}),
    ("<frozen os>", 5, "fspath"): (1, 1, 0.03, 0.03, {STEP: (1, 1, 0.03, 0.03)}),
    ADD: (3, 3, 2.0, 2.0, {SENSE: (3, 3, 2.0, 2.0)}),
}


def test_a_profile_counts_native_functions_for_who_calls_them():
    shares = sim_profile.own_shares(PROFILE)
    assert shares == pytest.approx(
        {"TorchRL": 0.15, "sim/simulator.py: sense": 0.45, "TensorDict": 0.397, "other": 0.003}
    )
    rows = sim_profile.share_rows(shares)
    assert rows == [
        ["sim/simulator.py: sense", "45.0%"],
        ["TensorDict", "39.7%"],
        ["TorchRL", "15.0%"],
        ["other", "0.3%"],
    ]
    assert sim_profile.reset_share(PROFILE) == pytest.approx(0.4)


def test_only_what_is_measured_is_profiled():
    profile = cProfile.Profile()
    drive_course(CONTESTANTS["env"], Course(["paper"], [2], 1e-9), profile)
    profile.create_stats()
    names = {name for _, _, name in profile.stats}
    assert {"drive_for", "step_and_maybe_reset"} <= names
    assert "load" not in names


@pytest.fixture
def measured(monkeypatch):
    """A benchmark in which everything is made up but its printing."""
    speeds = {"simulator": 4000, "env": 800, "vmas": 20, "vmas-64": 50}

    def measure(name, course):
        if name not in speeds:
            raise LeftOutError("it has a puncture")
        tracks = ["paper"] if CONTESTANTS[name].paper_only else course.tracks
        return [
            Cell(track, cars, cars * speeds[name], 1.0 + at) for cars in course.cars for at, track in enumerate(tracks)
        ]

    monkeypatch.setattr(sim, "measure", measure)
    monkeypatch.setattr(sim, "measure_limit", lambda program: 128_000.0)
    monkeypatch.setattr(sim, "time_first_use", lambda: {"empty": 4.0, "filled": 0.5})
    monkeypatch.setattr(sim.sim_profile, "profile_env", lambda track, cars, seconds: ([["all", f"{cars}"]], 0.25))


def test_the_race_prints_its_tables_and_keeps_every_round(measured, tmp_path, capsys):
    kept, program, road = tmp_path / "figures.json", tmp_path / "program", tmp_path / "road.csv"
    program.touch()
    road.write_text("# x_m,y_m,w_tr_right_m,w_tr_left_m\n0,0,2,3\n40,0,2,3\n40,40,2,3\n0,40,2,3\n")
    options = ["--rounds", "2", "--cars", "16,4", "--markdown", "--json", str(kept), "--limit-program", str(program)]
    assert sim.main([*options, "--track", "paper", "--track", str(road), "--profile"]) == 0
    printed = capsys.readouterr().out
    assert "| CarRL simulator, road | 8,000 | 32,000 |" in printed
    cells = "| CarRL simulator, road | 16 | 32,000 | 32,000..32,000 | 100 (100..100) | 40.0 (40.0..40.0) "
    assert cells + "| 0.25 (0.25..0.25) | 0.50 (0.50..0.50) |" in printed
    assert "Left out: CarRL, gymnasium.make_vec: it has a puncture." in printed
    assert "4.0 s with empty caches of compiled code, 0.5 s with filled" in printed
    assert "| all | 16 |" in printed
    found = json.loads(kept.read_text())
    assert found["speed"]["VMAS, 64 walls, paper"] == {"4": [200.0] * 2, "16": [800.0] * 2}
    assert found["limit"] == [128_000.0] * 2
    assert found["profile"]["paper"] == {"cars": 16, "rows": [["all", "16"]], "resets": 0.25}


def test_cars_a_world_are_compared_with_cars_alone(measured, monkeypatch, tmp_path, capsys):
    cost = {"paper": {1: [300.0, 310.0, 320.0], 4: [341.0, 330.0, 360.0]}, "race": {1: [1000.0] * 3, 4: [900.0] * 3}}
    monkeypatch.setattr(sim.sim_traffic, "measure_worlds", lambda track, counts, seconds, rounds: cost)
    kept = tmp_path / "figures.json"
    options = ["--no-race", "--cars-per-world", "1,4", "--markdown", "--track", "paper", "--json", str(kept)]
    assert sim.main(options) == 0
    printed = capsys.readouterr().out
    assert "| the paper's car, 7 rays of 10 m | 4 | 341 | 330..360 | +10 % |" in printed
    assert "| single_track, 19 rays of 80 m | 4 | 900 | 900..900 | -10 % |" in printed
    assert json.loads(kept.read_text())["cars_per_world"]["paper"]["paper"]["4"] == [341.0, 330.0, 360.0]


@pytest.mark.parametrize("name", ["paper", "race"])
def test_worlds_whose_cars_touch_anything_begin_anew(name, monkeypatch):
    monkeypatch.setattr(sim_traffic, "CARS", 9)
    drive, cars = sim_traffic.make_drive(name, Track.load("grand_prix"), 4)
    assert cars == 8
    for _ in range(30):
        drive()
    contact = CarContact(torch.tensor([-1, 1, -1, -1]), *(torch.zeros(4) for _ in range(3)))
    outcome = Outcome(
        CarState.at(torch.zeros(4, 3)), torch.zeros(4, 1), torch.zeros(4, dtype=torch.bool), torch.zeros(4)
    )
    assert sim_traffic._ended(outcome, 1).tolist() == [False] * 4
    outcome.contact = contact
    assert sim_traffic._ended(outcome, 2).tolist() == [True, True, False, False]


def test_without_spa_and_vmas_their_columns_are_left_out_with_a_reason(measured, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(sim, "SPA", tmp_path / "Spa.csv")
    assert sim.main(["--only", "simulator", "--rounds", "1", "--cars", "4"]) == 0
    printed = capsys.readouterr().out
    assert "times" not in printed.split("Medians of")[0]
    assert f"Left out: Spa: there is no {tmp_path / 'Spa.csv'}; name its file with --track." in printed


def test_a_contestant_that_fails_is_one_sentence_and_exit_code_1(monkeypatch, capsys):
    broken = Contestant("simulator", "It", lambda track, cars: None)
    monkeypatch.setitem(CONTESTANTS, "simulator", broken)
    monkeypatch.setattr(sim_cells, "child_arguments", lambda name, course: ["-c", "raise SystemExit('no wheels')"])
    assert sim.main(["--only", "simulator", "--track", "paper"]) == 1
    last = capsys.readouterr().err.splitlines()[-1]
    assert last == "scripts/bench sim: `python -c raise SystemExit('no wheels')` failed: no wheels"


BAD_ARGUMENTS = [
    (["--rounds", "0"], "0 is not above 0"),
    (["--seconds", "long"], "invalid number value: 'long'"),
    (["--cars", "4,none"], "invalid list of whole numbers value: '4,none'"),
    (["--cars", "4,0"], "0 is not above 0"),
    (["--only", "rabbit"], "no contestant 'rabbit'; choose from: simulator"),
    (["--track", "nowhere"], "nowhere"),
    (["--limit-program", "nowhere"], "there is no program 'nowhere'; compile it first"),
    (["--json", "nowhere/figures.json"], "'nowhere/figures.json' cannot be written"),
    (["--no-race"], "leaves nothing to do"),
    (["--fly"], "unrecognized arguments: --fly"),
]


@pytest.mark.parametrize(("arguments", "message"), BAD_ARGUMENTS, ids=[" ".join(words) for words, _ in BAD_ARGUMENTS])
def test_bad_arguments_are_one_sentence_and_exit_code_2(arguments, message, capsys):
    with pytest.raises(SystemExit) as ended:
        sim.main(arguments)
    printed = capsys.readouterr()
    assert ended.value.code == 2
    assert message in printed.err
    assert (printed.err.count("\n"), printed.out) == (1, "")


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [name if name == "simulator" else pytest.param(name, marks=pytest.mark.exhaustive) for name in CONTESTANTS],
)
def test_every_contestant_drives_in_a_process_of_its_own(name):
    try:
        cells = sim_cells.measure(name, Course(["paper"], [1, 4], 0.01))
    except LeftOutError as reason:
        pytest.skip(str(reason))
    assert [cell.cars for cell in cells] == ([1] if CONTESTANTS[name].one_car else [1, 4])
    assert all(cell.steps >= cell.cars and cell.seconds > 0 for cell in cells)
