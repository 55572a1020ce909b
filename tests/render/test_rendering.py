"""Pictures of the cars: what is where on them, and that they need neither a display nor pygame until asked for."""

import sys
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
import torch

import carrl
from carrl.env.gym_env import make_follow_picture
from carrl.errors import ConfigError
from carrl.render.canvas import Area, View
from carrl.render.colours import DARK, SKY, VERMILLION, YELLOW, nearness_colour, rgb
from carrl.render.live import FLEET
from tests.operations import count_calls


@pytest.fixture
def pygame():
    return pytest.importorskip("pygame", reason="a window needs pygame; pip install 'carrl[render]'")


def make(**options):
    env = carrl.GymTrackEnv(render_mode="rgb_array", **options)
    env.reset(seed=0)
    return env


def picture_of(track):
    """What draws the track, and a car on its start line."""
    env = make(track=track)
    return make_follow_picture(env.task), env


def pose_at(env, station):
    """A pose on the centreline, [3]."""
    state = env.task.simulator.start(stations=torch.tensor([station], dtype=torch.float64))
    return state.pose.double().numpy()[0]


def where(picture, colour, tolerance=40):
    """Rows and columns of the pixels of about this colour, [K, 2]."""
    distance = np.abs(picture.astype(int) - np.array(rgb(colour))).sum(axis=-1)
    return np.argwhere(distance < tolerance)


def below_panels(picture):
    """The picture without its upper part, where the table and the map are, and its legend."""
    return picture[150:430]


def test_a_picture_is_an_array_of_its_own():
    env = make()
    first = env.render()
    kept = first.copy()
    env.step(1)
    second = env.render()
    assert (first.shape, first.dtype) == ((480, 640, 3), np.uint8)
    np.testing.assert_array_equal(first, kept)
    assert (first != second).any()
    assert first.flags.writeable


def test_the_same_episode_gives_the_same_pictures():
    pictures = []
    for env in (make(), make()):
        for action in (0, 1, 2, 0):
            env.step(action)
        pictures.append(env.render())
    np.testing.assert_array_equal(*pictures)


def test_the_car_is_in_the_middle_and_the_road_about_it():
    picture = make(track="oval").render()
    middle = where(picture[225:256, 305:336], DARK.car).mean(axis=0)
    assert np.abs(middle - 15).max() < 4
    assert tuple(picture[200, 300]) == rgb(DARK.road)
    assert tuple(picture[400, 300]) == rgb(DARK.ground)


def test_the_walls_are_drawn_to_scale():
    picture = make(track="oval").render()  # at the start a straight road along x, 5 m to either side; 20 px are 1 m
    rows = where(picture[:, 300:301], DARK.wall)[:, 0]
    assert abs(rows - 140).min() <= 1
    assert abs(rows - 340).min() <= 1
    assert set(rows) <= {*range(137, 144), *range(337, 344)}


def test_the_car_drives_upwards_where_y_grows():
    view = View(Area(0, 0, 100, 60), np.array([1.0, 2.0]), 10.0)
    views = view.places(np.array([[1.0, 2.0], [2.0, 2.0], [1.0, 3.0]]))
    assert views.tolist() == [[50, 30], [60, 30], [50, 20]]


def test_a_ray_is_coloured_by_how_near_its_wall_is():
    near, middle, far = (rgb(nearness_colour(reading)) for reading in (0.0, 0.5, 1.0))
    assert (near, middle, far) == tuple(map(rgb, (VERMILLION, YELLOW, SKY)))


def test_rays_end_where_the_sensor_says():
    scene = make(track="oval").snapshot()  # 5 m to each wall, at right angles to the heading
    picture = make(track="oval").render()
    assert scene.readings[[0, -1]].tolist() == [0.5, 0.5]
    for row in (140, 340):
        assert len(where(picture[row - 3 : row + 4, 317:324], nearness_colour(0.5))) > 20


def test_the_next_gate_stands_out_and_the_others_do_not():
    picture, env = picture_of("oval")
    pose = pose_at(env, env.task.simulator.track.gate_stations[0].item() - 6)
    next_one, another = (picture.draw(replace(env.snapshot(), pose=pose, next_gate=gate)) for gate in (0, 4))
    lit, unlit = (len(where(below_panels(each), DARK.next_gate)) for each in (next_one, another))
    assert lit > unlit + 400


def test_a_collision_shows():
    env = make(track="oval")
    while not env.step(0)[2]:
        pass
    assert len(where(env.render()[225:256, 305:336], DARK.crash)) > 50


def test_the_trail_follows_the_car_and_ends_with_the_episode():
    env = make()
    for _ in range(5):
        env.step(0)
    np.testing.assert_allclose(np.stack(env.snapshot().trail)[:, 0], 12 + np.arange(5), atol=1e-4)
    env.reset()
    assert len(env.snapshot().trail) == 0


def test_a_message_stands_below_the_car():
    picture, env = picture_of("paper")
    plain = picture.draw(env.snapshot())
    written = picture.draw(env.snapshot(), ("pause", "P\tgo on"))
    changes = np.argwhere((plain != written).any(axis=-1))
    assert np.abs(changes.mean(axis=0) - (336, 320)).max() < 30


def test_the_upper_road_of_a_bridge_hides_the_walls_below(real_circuits):
    track = carrl.Track.load(real_circuits / "Suzuka.csv")
    (bridge,) = track.bridges
    crossing = sum(bridge.over) / 2
    picture, env = picture_of(track)
    middle = pose_at(env, crossing)
    shown = picture.draw(replace(env.snapshot(), pose=middle, readings=np.zeros(7)))
    view = picture.view(middle[:2])
    for ahead in np.arange(2.5, 9.0, 0.25):
        for station in (crossing - ahead, crossing + ahead):
            column, row = view.places(pose_at(env, station)[:2]).round().astype(int)
            assert (shown[row, column] >= rgb(DARK.road)).all()  # or a gate, or the edge of one
            assert (shown[row, column] <= rgb(DARK.gate)).all()


@pytest.mark.parametrize("track", ["paper", "Spa.csv"])
def test_a_picture_is_as_little_work_on_tracks_of_any_length(track, request):
    if track.endswith(".csv"):
        track = request.getfixturevalue("real_circuits") / track
    env = make(track=str(track))
    env.render()
    assert count_calls(env.render) < 6000


def test_a_noisy_sensor_with_the_last_action_and_a_slow_car_is_drawn_too():
    sensor = carrl.Sensor(rays=1, field_of_view=90, max_range=40, noise=0.5)
    env = make(
        sensor=sensor,
        observation=carrl.rays_and_last_action(),
        vehicle=carrl.Vehicle(time_step=0.05),
        track=["oval", "paper"],
    )
    env.step(2)
    assert env.render().shape == (480, 640, 3)
    assert env.metadata["render_fps"] == 20
    assert env.snapshot().readings.shape == (1,)


def test_all_cars_of_a_batch_are_on_one_picture():
    options = {
        "track": "oval",
        "render_mode": "rgb_array",
        "autoreset_mode": "Disabled",
        "start": carrl.Start(anywhere=True),
    }
    env = gymnasium.make_vec("carrl/Track-v0", num_envs=5, **options)
    env.reset(seed=1)
    (picture,) = env.render()
    assert picture.shape == (480, 640, 3)
    for colour in FLEET:
        assert len(where(picture, colour, 60)) > 10
    for _ in range(60):
        _, _, ended, _, _ = env.step(np.zeros(5, dtype=int))
        if ended.any():
            break
    assert len(where(env.render()[0], DARK.crash)) > 10


def test_a_batch_on_several_tracks_shows_the_first():
    env = gymnasium.make_vec("carrl/Track-v0", num_envs=3, track=["oval", "paper"], render_mode="rgb_array")
    alone = gymnasium.make_vec("carrl/Track-v0", num_envs=2, track="oval", render_mode="rgb_array")
    env.reset()
    alone.reset()
    np.testing.assert_array_equal(env.render()[0][60:], alone.render()[0][60:])


def test_a_window_shows_each_step(monkeypatch, pygame):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = gymnasium.make("carrl/Track-v0", render_mode="human", vehicle=carrl.Vehicle(time_step=0.01))
    env.reset()
    shown = pygame.surfarray.array3d(pygame.display.get_surface())
    env.step(1)
    assert (pygame.surfarray.array3d(pygame.display.get_surface()) != shown).any()
    assert env.render() is None
    env.close()
    env.close()
    assert not pygame.display.get_init()


def test_a_window_of_many_cars_opens_and_closes(monkeypatch, pygame):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = gymnasium.make_vec("carrl/Track-v0", num_envs=2, render_mode="human", vehicle=carrl.Vehicle(time_step=0.01))
    env.reset()
    env.step(np.array([0, 1]))
    assert pygame.display.get_surface().get_size() == (640, 480)
    env.close()
    assert not pygame.display.get_init()


@pytest.mark.usefixtures("pygame")
def test_no_display_is_said_in_one_sentence(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "nosuchdriver")
    env = gymnasium.make("carrl/Track-v0", render_mode="human")
    with pytest.raises(ConfigError, match=r"no window can be opened: .*rgb_array"):
        env.reset()


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere a display is always there")
@pytest.mark.usefixtures("pygame")
def test_a_window_that_nobody_would_see_is_refused(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(ConfigError, match="no window can be opened: no display was found"):
        carrl.GymTrackEnv(render_mode="human").reset()


def test_without_pygame_pictures_are_drawn_and_a_window_names_the_remedy(monkeypatch):
    monkeypatch.setitem(sys.modules, "pygame", None)
    monkeypatch.delitem(sys.modules, "carrl.render.live", raising=False)
    for make_one in (carrl.GymTrackEnv, carrl.GymVectorTrackEnv):
        env = make_one(render_mode="rgb_array")
        env.reset()
        assert env.render() is not None
        with pytest.raises(ConfigError, match=r"pip install 'carrl\[render\]'"):
            make_one(render_mode="human").reset()


def test_headless_drawing_opens_no_display(pygame):
    make().render()
    assert not pygame.display.get_init()
