"""`carrl drive` without a display: what the keys do, what is printed, how it refuses."""

import sys

import numpy as np
import pytest
import yaml

from carrl.cli.main import main
from tests.configs import compose

pygame = pytest.importorskip("pygame", reason="the window needs pygame; pip install 'carrl[render]'")

from carrl.cli.driver import PedalsDriver  # noqa: E402
from carrl.env.gym_env import GymTrackEnv  # noqa: E402
from carrl.errors import ConfigError  # noqa: E402
from carrl.render.window import Window  # noqa: E402


@pytest.fixture
def play(monkeypatch):
    """Runs the command and presses keys before the frames of the given numbers; returns the pictures shown."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")

    def run(presses, *arguments):
        shown = []
        show = Window.show

        def press_and_show(window, picture, fps):
            show(window, picture, 10_000)
            shown.append(picture)
            for kind, key in presses.get(len(shown), ()):
                pygame.event.post(pygame.event.Event(kind, key=key))
            assert len(shown) < 500, "nobody pressed Esc"

        with monkeypatch.context() as patch:
            patch.setattr(Window, "show", press_and_show)
            assert main(["drive", *arguments]) == 0
        return shown

    return run


class FakePad:
    """A gamepad as pygame shows it."""

    def __init__(self, index):
        self.index = index

    def get_instance_id(self):
        return self.index

    def get_name(self):
        return ("Sony DualShock 4", "Microsoft X-Box 360 pad")[self.index]


@pytest.fixture
def pads(monkeypatch):
    """Two gamepads are plugged in."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    pygame.init()
    monkeypatch.setattr(pygame.joystick, "get_count", lambda: 2)
    monkeypatch.setattr(pygame.joystick, "Joystick", FakePad)


def axis(pad, number, value):
    return pygame.event.Event(pygame.JOYAXISMOTION, instance_id=pad, axis=number, value=value)


def key_event(kind, key):
    return pygame.event.Event(kind, key=key)


def down(*keys):
    return [(pygame.KEYDOWN, key) for key in keys]


def up(*keys):
    return [(pygame.KEYUP, key) for key in keys]


def lines(capsys):
    return capsys.readouterr().out.splitlines()


def test_it_waits_for_a_first_key_and_shows_the_keys(play, capsys):
    shown = play({5: down(pygame.K_ESCAPE)})
    assert len(shown) == 5
    for picture in shown[1:]:
        np.testing.assert_array_equal(picture, shown[0])
    assert lines(capsys) == []


def test_without_keys_the_car_drives_straight_on_until_it_hits_a_wall(play, capsys):
    play({1: down(pygame.K_UP) + up(pygame.K_UP), 60: down(pygame.K_q)})
    assert lines(capsys) == ["attempt 1: 33 steps, 1 gates, 0 laps, reward -150, hit a wall"]


@pytest.mark.parametrize("key", ["K_LEFT", "K_a", "K_RIGHT", "K_d"])
def test_a_key_held_turns_the_car_until_it_is_let_go(play, capsys, key):
    key = getattr(pygame, key)
    shown = play({1: down(key), 4: up(key), 7: down(pygame.K_ESCAPE)}, "--track", "oval")
    assert lines(capsys) == ["attempt 1: 6 steps, 0 gates, 0 laps, reward 0, stopped"]
    assert (shown[1] != shown[2]).any()


def test_keys_become_the_actions_of_their_names(monkeypatch, play):
    taken = []
    step = GymTrackEnv.step
    monkeypatch.setattr(GymTrackEnv, "step", lambda env, action: [taken.append(int(action)), step(env, action)][1])
    left, right = pygame.K_LEFT, pygame.K_RIGHT
    tap = down(left) + up(left)
    play(
        {1: tap, 3: down(right), 5: down(left), 6: up(left), 7: up(right), 8: down(pygame.K_ESCAPE)}, "--track", "oval"
    )
    assert taken == [1, 0, 2, 2, 1, 2, 0]


def test_the_pause_stops_the_car_and_ends_on_the_same_key(play, capsys):
    pause = down(pygame.K_p)
    shown = play({1: down(pygame.K_UP), 4: pause, 8: pause, 10: down(pygame.K_ESCAPE)})
    np.testing.assert_array_equal(shown[4], shown[7])
    assert lines(capsys) == ["attempt 1: 5 steps, 0 gates, 0 laps, reward 0, stopped"]


def test_help_stops_the_car_as_well(play, capsys):
    shown = play({1: down(pygame.K_UP), 3: down(pygame.K_h), 6: down(pygame.K_h), 8: down(pygame.K_ESCAPE)})
    np.testing.assert_array_equal(shown[3], shown[5])
    assert lines(capsys) == ["attempt 1: 4 steps, 0 gates, 0 laps, reward 0, stopped"]


def test_each_restart_begins_another_attempt(play, capsys):
    play({1: down(pygame.K_UP), 3: down(pygame.K_r), 8: down(pygame.K_r), 9: [(pygame.QUIT, 0)]})
    assert lines(capsys) == [
        "attempt 1: 2 steps, 0 gates, 0 laps, reward 0, stopped",
        "attempt 2: 5 steps, 0 gates, 0 laps, reward 0, stopped",
        "attempt 3: 1 steps, 0 gates, 0 laps, reward 0, stopped",
    ]


def test_laps_are_counted(play, capsys, tmp_path):
    circle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    rows = [f"{7.2 * np.sin(angle)},{7.2 * np.cos(angle)},3,3" for angle in -circle]
    file = tmp_path / "circle.csv"
    file.write_text("\n".join(["# x_m,y_m,w_tr_right_m,w_tr_left_m", *rows]))
    play({1: down(pygame.K_LEFT), 60: down(pygame.K_ESCAPE)}, "--track", str(file))
    (line,) = lines(capsys)
    assert line.startswith("attempt 1: 59 steps, 3 gates, 1 laps")


def test_a_runs_car_and_track_are_taken(play, capsys, tmp_path):
    (tmp_path / ".hydra").mkdir()
    config = compose("track=oval", "vehicle.speed=20", "reward.gate.weight=7")
    (tmp_path / ".hydra" / "config.yaml").write_text(yaml.safe_dump(config))
    play({1: down(pygame.K_UP), 60: down(pygame.K_ESCAPE)}, "--run", str(tmp_path))
    assert lines(capsys) == ["attempt 1: 19 steps, 1 gates, 0 laps, reward -213, hit a wall"]


def test_no_display_and_no_pygame_are_one_sentence_each(monkeypatch, capsys):
    monkeypatch.setenv("SDL_VIDEODRIVER", "nosuchdriver")
    assert main(["drive"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("carrl: no window can be opened: ")
    monkeypatch.setitem(sys.modules, "pygame", None)
    monkeypatch.delitem(sys.modules, "carrl.render.window")
    assert main(["drive"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line == "carrl: a window needs pygame, which is not installed; pip install 'carrl[render]'"


@pytest.mark.parametrize("fps", ["0", "-1", "nan", "inf"])
def test_a_pace_that_is_none_is_refused(fps, capsys):
    assert main(["drive", "--fps", fps]) == 2
    assert "--fps is" in capsys.readouterr().err


def test_a_held_key_turns_the_wheel_step_by_step_and_it_comes_back_faster():
    driver = PedalsDriver(("steer", "pedal"), time_step=0.1)
    driver.take(key_event(pygame.KEYDOWN, pygame.K_LEFT))
    assert [driver.next_action()[0] for _ in range(6)] == pytest.approx([0.2, 0.4, 0.6, 0.8, 1.0, 1.0])
    driver.take(key_event(pygame.KEYUP, pygame.K_LEFT))
    assert [driver.next_action()[0] for _ in range(4)] == pytest.approx([0.6, 0.2, 0.0, 0.0])
    driver.take(key_event(pygame.KEYDOWN, pygame.K_d))
    assert driver.next_action()[0] == pytest.approx(-0.2)


def test_a_tapped_pedal_counts_for_one_step_and_the_keys_of_a_held_one_until_it_is_let_go():
    driver = PedalsDriver(("steer", "throttle", "brake"), time_step=0.1)
    for kind in (pygame.KEYDOWN, pygame.KEYUP):
        driver.take(key_event(kind, pygame.K_UP))
    assert [driver.next_action().tolist() for _ in range(2)] == [[0, 1, -1], [0, -1, -1]]
    driver.take(key_event(pygame.KEYDOWN, pygame.K_s))
    assert [driver.next_action().tolist() for _ in range(2)] == [[0, -1, 1]] * 2


@pytest.mark.parametrize(("pad", "brake_axis"), [(0, 4), (1, 2)], ids=["PlayStation", "Xbox"])
def test_stick_and_triggers_of_a_gamepad_steer_and_move_the_pedals(pads, pad, brake_axis):
    driver = PedalsDriver(("steer", "pedal"), time_step=0.1)
    assert driver.next_action().tolist() == [0, 0]  # a trigger that was never moved is released
    assert driver.take(axis(pad, 0, -0.5))  # to the left
    assert driver.take(axis(pad, 5, 0.0))  # half-way down
    assert driver.next_action() == pytest.approx([0.5, 0.5])
    assert driver.take(axis(pad, brake_axis, 1.0))
    assert driver.next_action() == pytest.approx([0.5, -0.5])
    assert not driver.take(axis(pad, 0, 0.05))  # as good as the middle
    assert not driver.take(axis(pad, 5, -1.0))
    other = {2: 4, 4: 2}[brake_axis]
    assert not driver.take(axis(pad, other, 1.0))  # another stick
    assert driver.next_action() == pytest.approx([0.0, -1.0])


def test_a_car_with_a_control_that_no_key_moves_is_refused():
    with pytest.raises(ConfigError, match="the car has the control 'clutch', which no key moves; cars with steer, "):
        PedalsDriver(("steer", "clutch"), time_step=0.1)


def test_a_car_with_pedals_is_driven_by_hand_and_its_speed_is_told(play, capsys):
    shown = play({1: down(pygame.K_UP), 30: down(pygame.K_LEFT), 36: down(pygame.K_ESCAPE)}, "--vehicle", "kinematic")
    (line,) = lines(capsys)
    assert line.startswith("attempt 1: 35 steps")
    assert (shown[20] != shown[10]).any()


def test_a_person_races_from_behind_and_hears_that_a_car_was_hit(play, capsys):
    race = ("--opponents", "line", "--cars", "2", "--track", "oval")
    play({1: down(pygame.K_UP), 200: down(pygame.K_ESCAPE)}, *race)
    (line,) = lines(capsys)
    assert line.endswith(("hit a car", "hit a wall"))


def test_cars_without_opponents_and_opponents_beside_a_run_are_refused(capsys):
    assert main(["drive", "--cars", "3"]) == 2
    assert "--cars has no effect without --opponents" in capsys.readouterr().err
    assert main(["drive", "--opponents", "line", "--run", "somewhere"]) == 2
    assert "--opponents has no effect beside --run" in capsys.readouterr().err
