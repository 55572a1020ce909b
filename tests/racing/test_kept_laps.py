"""Laps kept between processes."""

from dataclasses import replace

import numpy as np
import pytest

from carrl.cache import cache_dir
from carrl.errors import TrackError
from carrl.racing import kept_laps
from carrl.racing.kept_laps import kept_lap
from carrl.sim.single_track import SingleTrack
from carrl.tracks.track import Track
from tests.racing.laps import SPACING, oval_lap


@pytest.fixture(autouse=True)
def found(tmp_path, monkeypatch):
    """A list of the laps that had to be found, in an empty cache; each is the same."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    laps = []

    def find(*arguments):
        laps.append(arguments)
        return oval_lap()

    monkeypatch.setattr(kept_laps, "minimum_lap", find)
    monkeypatch.setattr(kept_laps, "point_mass_lap", find)
    return laps


def test_a_lap_is_found_once(found):
    first, second = (kept_lap(Track.load("oval"), SingleTrack(), SPACING) for _ in range(2))
    assert len(found) == 1
    np.testing.assert_array_equal(first.line.closed().x, second.line.closed().x)
    assert second.lap_time == first.lap_time
    assert (second.at_walls, second.iterations, second.model) == (first.at_walls, first.iterations, "single track")
    (path,) = cache_dir().iterdir()
    assert path.stat().st_mode & 0o777 == 0o600


def test_another_road_car_grid_margin_or_model_is_another_lap(found):
    oval, car = Track.load("oval"), SingleTrack()
    kept_lap(oval, car, SPACING)
    kept_lap(oval.mirrored(), car, SPACING)
    kept_lap(oval, replace(car, friction=0.9), SPACING)
    kept_lap(oval, car, SPACING / 2)
    kept_lap(oval, car, SPACING, margin=0.1)
    kept_lap(oval, car, SPACING, quick=True)
    assert len(found) == len(list(cache_dir().iterdir())) == 6


DAMAGE = {
    "no JSON": lambda path: path.write_text("{"),
    "no lap": lambda path: path.write_text("[]"),
    "a column less": lambda path: path.write_text(path.read_text().replace('"slip"', '"slop"')),
    "a value that is none": lambda path: path.write_text(path.read_text().replace('"x": [', '"x": [NaN, ')),
    "others may write to it": lambda path: path.chmod(0o602),
    "a link to another file": lambda path: path.rename(path.parent / "target") and path.symlink_to("target"),
}


@pytest.mark.parametrize("damage", DAMAGE.values(), ids=DAMAGE.keys())
def test_a_damaged_file_is_deleted_and_the_lap_found_again(damage, found, caplog):
    kept_lap(Track.load("oval"), SingleTrack(), SPACING)
    damage(next(cache_dir().iterdir()))
    assert kept_lap(Track.load("oval"), SingleTrack(), SPACING).lap_time == oval_lap().lap_time
    assert len(found) == 2
    assert "cannot be used" in caplog.text


def test_there_are_never_more_laps_than_fit(found, monkeypatch):
    monkeypatch.setattr(kept_laps, "MAX_BYTES", 1)
    for margin in (0.0, 0.1):
        kept_lap(Track.load("oval"), SingleTrack(), SPACING, margin)
    assert len(list(cache_dir().iterdir())) == 1


def test_a_full_disk_takes_no_lap_away(found, monkeypatch, caplog):
    def fail(*arguments):
        raise TrackError("no space is left")

    monkeypatch.setattr(kept_laps, "write_whole", fail)
    assert kept_lap(Track.load("oval"), SingleTrack(), SPACING).lap_time == oval_lap().lap_time
    assert "The minimum lap is not kept: no space is left." in caplog.text


def test_nothing_is_kept_where_others_can_write(found, caplog):
    cache_dir().mkdir(parents=True)
    cache_dir().chmod(0o777)
    kept_lap(Track.load("oval"), SingleTrack(), SPACING)
    assert "Minimum laps are not kept: " in caplog.text
    assert list(cache_dir().iterdir()) == []
