"""Lap times on the terminal."""

from carrl.cli.text.lap_times import print_lap_times

LAPS = {"begun": 120, "counted": 118, "mean_s": 123.456, "best_s": 120.0, "sectors_s": [41.0, 42.0, 40.456]}
CRASHED = {"begun": 120, "counted": 0, "mean_s": None, "best_s": None, "sectors_s": []}
GRIP = {"grip_mean": 0.512, "grip_greatest": 0.99, "steering_change": 0.0314}


def track(name, standing, flying, **figures):
    return {"track": name, "lap_times": {"standing": standing, "flying": flying, "limit_s": 110.0}, **figures}


def test_standing_and_flying_laps_with_sectors_and_limit_fit_80_columns(capsys):
    print_lap_times([track("MoscowRaceway", CRASHED, LAPS | {"share_of_limit": 1.1223}, **GRIP)])
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80
    cells = [line.split() for line in lines if "MoscowRaceway" in line]
    assert cells[0][3::2] == ["0/120", "-", "-", "-", "-", "-", "-"]
    assert cells[1][3::2] == ["118/120", "123.46", "120.00", "1.122", "41.00", "42.00", "40.46"]
    assert cells[2][3::2] == ["0.512", "0.990", "0.031"]
    assert "laps that were not completed, or in which the car touched a wall, do not count" in lines


def test_a_rule_that_has_flying_laps_alone_stands_below_its_track(capsys):
    every = {"begun": 2, "counted": 2, "mean_s": 21.0, "best_s": 20.9, "sectors_s": [7.0, 7.0, 7.0]}
    print_lap_times([{"track": "oval", "lap_times": {"flying": every}, "rule": {"lap_times": {"flying": every}}}])
    out = capsys.readouterr().out
    assert "standing" not in out and "grip" not in out and "limit" not in out and "do not count" not in out
    assert out.index("oval") < out.index("rule")
