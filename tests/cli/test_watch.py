"""`carrl watch` and what `carrl evaluate` keeps: keys, pages, videos, refusals; no display is needed."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

from carrl.cli.main import main
from carrl.env.gym_env import GymTrackEnv
from carrl.log import read_episodes
from carrl.log.reader import Log
from carrl.train.checkpoint import load_checkpoint, save_checkpoint
from tests.export.untrained_runs import write_untrained_run

pygame = pytest.importorskip("pygame", reason="the window needs pygame; pip install 'carrl[render]'")

from carrl.render.window import Window  # noqa: E402


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run whose network drives some steps, until it hits a wall."""
    return write_untrained_run(tmp_path_factory.mktemp("watched") / "run")


@pytest.fixture
def watch(monkeypatch):
    """Runs the command and does things before the frames of the given numbers; returns the pictures shown."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")

    def run(acts, *arguments):
        shown = []
        show = Window.show

        def act_and_show(window, picture, fps):
            show(window, picture, 10_000)
            shown.append(picture)
            for act in acts.get(len(shown), ()):
                act() if callable(act) else pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=act))
            assert len(shown) < 500, "nobody pressed Esc"

        with monkeypatch.context() as patch:
            patch.setattr(Window, "show", act_and_show)
            assert main(["watch", *map(str, arguments)]) == 0
        return shown

    return run


def lines(capsys):
    return capsys.readouterr().out.splitlines()


def test_laps_begin_at_places_along_the_track_the_first_at_the_start_line(watch, run, capsys):
    watch({3: [pygame.K_n], 6: [pygame.K_RIGHT], 8: [pygame.K_ESCAPE]}, run)
    first, second, third = lines(capsys)
    assert first == "lap 1 from the start line: left after 2 steps, 0.2 s, reward 0, network of 0 env steps"
    assert second.startswith("lap 2 from 62% of the way: left after 3 steps")
    assert third.startswith("lap 3 from 24% of the way: quit after")


def test_after_a_crash_the_next_lap_begins_by_itself(watch, run, capsys):
    watch({150: [pygame.K_q]}, run, "--fps", "4")
    ends = [line.split(": ")[1].split(" after")[0] for line in lines(capsys)]
    assert len(ends) >= 2
    assert ends[0] == "hit a wall"


def test_a_car_that_was_hit_is_called_no_wall(watch, run, capsys, monkeypatch):
    seen = GymTrackEnv.snapshot
    monkeypatch.setattr(GymTrackEnv, "snapshot", lambda env: replace(seen(env), collided=True, hit_car=True))
    watch({5: [pygame.K_q]}, run)
    assert lines(capsys)[0].startswith("lap 1 from the start line: hit a car after 1 steps")


def test_pause_and_help_stop_the_car(watch, run):
    shown = watch({3: [pygame.K_p], 6: [pygame.K_h], 9: [pygame.K_h], 11: [pygame.K_p], 14: [pygame.K_q]}, run)
    np.testing.assert_array_equal(shown[3], shown[5])
    np.testing.assert_array_equal(shown[6], shown[8])
    assert (shown[5] != shown[6]).any()
    np.testing.assert_array_equal(shown[9], shown[3])
    assert (shown[11] != shown[12]).any()


def test_another_track_may_be_driven(watch, run, capsys, monkeypatch):
    titles = []
    monkeypatch.setattr(pygame.display, "set_caption", titles.append)
    watch({3: [pygame.K_q]}, run, "--track", "serpentine")
    assert titles == ["CarRL: serpentine"]


def test_a_run_in_progress_is_asked_for_its_newest_network_before_each_lap(watch, tmp_path, capsys):
    run = write_untrained_run(tmp_path / "run")
    last = run / "checkpoints" / "last.pt"
    (run / "checkpoints" / "best.pt").unlink()

    def train_on():
        saved = load_checkpoint(last)
        save_checkpoint(last, {"network": saved["network"], "frames": saved.get("frames", 0) + 1500})

    train_on()
    watch({2: [train_on], 4: [pygame.K_n], 7: [pygame.K_q]}, run, "--live")
    assert [line.split(", ")[-1] for line in lines(capsys)] == [
        "network of 1,500 env steps",
        "network of 3,000 env steps",
    ]


def test_a_page_and_videos_show_a_lap_without_a_window(run, tmp_path, capsys, monkeypatch):
    pytest.importorskip("av", reason="a video needs PyAV; pip install 'carrl[export]'")
    for name in ("SDL_VIDEODRIVER", "DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    for out in (tmp_path / "lap.html", tmp_path / "lap.gif"):
        assert main(["watch", str(run), "--track", "oval", "--out", str(out)]) == 0
        assert lines(capsys)[0].startswith(f"{out}: drive 0 on oval, ")
    page = (tmp_path / "lap.html").read_text()
    assert "best network of run, drive 0 on oval" in page
    assert (tmp_path / "lap.gif").read_bytes()[:3] == b"GIF"


def test_without_a_display_one_sentence_names_what_needs_none(run, monkeypatch, capsys):
    for name in ("SDL_VIDEODRIVER", "DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    assert main(["watch", str(run)]) == 2
    assert capsys.readouterr().err == (
        "carrl: no window can be opened: no display was found; --out FILE.html, or .mp4, or .gif, needs no display\n"
    )


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        (["--out", "lap.avi"], "--out is 'lap.avi'; its name must end in .html, .mp4 or .gif"),
        (["--out", "nowhere/lap.html"], "'nowhere/lap.html' cannot be written"),
        (["--out", "lap.html", "--fps", "5"], "--fps has no effect beside --out"),
        (["--fps", "0"], "--fps is 0.0"),
        (["--track", "nowhere"], "track 'nowhere'"),
    ],
)
def test_what_cannot_be_watched_is_one_sentence(run, flags, says, capsys):
    assert main(["watch", str(run), *flags]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert says in line


def test_a_run_without_a_network_yet_and_a_run_of_seeds_are_refused(tmp_path, capsys):
    run = write_untrained_run(tmp_path / "both" / "seed=0")
    (run / "checkpoints" / "last.pt").unlink()
    assert main(["watch", str(run), "--live", "--out", str(tmp_path / "lap.html")]) == 2
    assert "last.pt' is not there yet; a run in progress has it from its first evaluation on" in capsys.readouterr().err
    write_untrained_run(tmp_path / "both" / "seed=1", seed=1)
    assert main(["watch", str(tmp_path / "both")]) == 2
    assert "here are 2; name the folder of one" in capsys.readouterr().err


def test_evaluate_keeps_a_log_a_picture_and_a_video(run, tmp_path, capsys):
    pytest.importorskip("av", reason="a video needs PyAV; pip install 'carrl[export]'")
    log, png, video = (tmp_path / name for name in ("drive.mcap", "lap.png", "lap.gif"))
    typed = ["evaluate", str(run), "--track", "oval", "--starts", "2"]
    assert main([*typed, "--log", str(log), "--png", str(png), "--video", str(video), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert list(document["files"]) == [str(log), str(png), str(video)]
    returns = [episode.episode_return for episode in read_episodes(log)]
    assert len(returns) == document["tracks"][0]["starts"] == 2
    assert document["files"][str(png)].startswith(f"drive {np.argmax(returns)} on oval, ")
    assert png.read_bytes()[1:4] == b"PNG"
    assert video.read_bytes()[:3] == b"GIF"
    assert main(["log", "check", str(log)]) == 0
    assert main([*typed, "--log", str(log)]) == 2
    assert "no log is written over another file" in capsys.readouterr().err


def test_evaluate_draws_without_keeping_a_log(run, tmp_path, capsys):
    assert main(["evaluate", str(run), "--track", "oval", "--png", str(tmp_path / "lap.svg")]) == 0
    assert lines(capsys)[-6].startswith(f"{tmp_path / 'lap.svg'}: drive 0 on oval, ")
    assert [path.name for path in tmp_path.iterdir()] == ["lap.svg"]
    assert b"<svg" in (tmp_path / "lap.svg").read_bytes()


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        (["--log", "drive.csv"], "it must end in .mcap"),
        (["--png", "lap.gif"], "--png is 'lap.gif'; its name must end in .png, .pdf or .svg"),
        (["--video", "lap.png"], "--video is 'lap.png'; its name must end in .mp4 or .gif"),
        (["--png", "nowhere/lap.png"], "'nowhere/lap.png' cannot be written"),
    ],
)
def test_what_cannot_be_kept_is_one_sentence(run, flags, says, capsys):
    assert main(["evaluate", str(run), *flags]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert says in line


def test_an_episode_of_a_log_becomes_a_picture(run, tmp_path, capsys):
    log = tmp_path / "drive.mcap"
    assert main(["evaluate", str(run), "--track", "oval", "--log", str(log)]) == 0
    capsys.readouterr()
    for name, begins in (("lap.png", b"\x89PNG"), ("lap.pdf", b"%PDF")):
        assert main(["log", "export", str(log), str(tmp_path / name)]) == 0
        assert (tmp_path / name).read_bytes().startswith(begins)
    with Log(log) as opened:
        assert opened.metadata["policy"] == "greedy"
