"""What `scripts/soak` counts, and that it finds out what grows."""

import subprocess
import sys

import pytest

from benchmarks.child import ROOT, environment
from benchmarks.soak import soak
from benchmarks.soak.process import Sample, frames_in
from benchmarks.soak.verdict import growth, parts, row

FRAMES = 1000


def samples(memory=lambda frames: 500.0, handles=lambda frames: 9):
    """Looks at a run, one every 10 frames."""
    return [
        Sample(frames / 100, frames, memory(frames), handles(frames), 4, frames / 500)
        for frames in range(0, FRAMES, 10)
    ]


def test_a_run_is_told_in_ten_parts():
    in_parts = parts(samples(), FRAMES)
    assert [len(part) for part in in_parts] == [9, *[10] * 9]
    assert row(1, in_parts[1], FRAMES, 0.9) == ["200", "2", "100", "500.0", "500.0", "9", "9", "4", "0.4"]
    assert row(1, [], FRAMES, 0.9)[:3] == ["200", "-", "-"]


@pytest.mark.parametrize(
    ("grown", "words"),
    [
        (samples(memory=lambda frames: 500 + frames * 0.05), "memory grew from 512.2 MiB to 542.2 MiB in part 9 of 10"),
        (samples(handles=lambda frames: 9 + frames // 600), "handles grew from 9 in part 7 of 10"),
        (samples()[:20], "too short to tell"),
        ([], "too short to tell"),
    ],
    ids=["memory", "handles", "too short", "none"],
)
def test_what_grows_is_found_out(grown, words):
    assert any(words in fault for fault in growth(parts(grown, FRAMES)))


def test_neither_the_filling_of_the_buffer_nor_a_moment_is_growth():
    filling = samples(memory=lambda frames: 500 + min(frames, 200))
    momentary = samples(
        memory=lambda frames: 900.0 if frames % 100 == 50 else 500.0, handles=lambda frames: 9 + (frames % 100 == 50)
    )
    for flat in (filling, momentary):
        assert list(growth(parts(flat, FRAMES))) == []


def test_frames_are_those_of_the_last_whole_row(tmp_path):
    metrics = tmp_path / "metrics.csv"
    assert frames_in(metrics) == 0
    for content, frames in (("", 0), ("episode,frame,env\r\n", 0), ("1,80,1\r\n", 80), ("2,120,0\r\n3,14", 120)):
        with metrics.open("a", newline="") as file:
            file.write(content)
        assert frames_in(metrics) == frames
    metrics.write_text("episode,frame\n" + "".join(f"{number},{10 * number}\n" for number in range(1, 2001)))
    assert frames_in(metrics) == 20_000


def test_growth_gives_exit_code_1(monkeypatch, capsys):
    monkeypatch.setattr(soak, "watch", lambda overrides: iter(samples(memory=lambda frames: 500 + frames)))
    assert soak.main(["--frames", str(FRAMES)]) == 1
    assert "FAULT: memory grew" in capsys.readouterr().out
    monkeypatch.setattr(soak, "watch", lambda overrides: iter(samples()))
    assert soak.main(["--frames", str(FRAMES)]) == 0
    assert "Nothing grows." in capsys.readouterr().out


@pytest.mark.slow
def test_a_run_that_fails_is_one_sentence(capsys):
    assert soak.main(["--frames", "10", "threads=0"]) == 1
    assert "scripts/soak: `carrl train trainer.frames=10" in (error := capsys.readouterr().err)
    assert error.endswith("threads is 0; it must be a whole number from 1 to 1024\n")


def test_bad_arguments_are_one_sentence_and_exit_code_2(capsys):
    with pytest.raises(SystemExit) as ended:
        soak.main(["--frames", "0"])
    assert ended.value.code == 2
    assert "0 is not above 0" in capsys.readouterr().err


@pytest.mark.slow
def test_a_real_run_is_watched():
    tiny = ["compile=false", "track=oval", "env.num_envs=8", "replay_buffer.capacity=512"]
    tiny += ["trainer.frames_per_update=8"]
    command = [sys.executable, "-m", "benchmarks.soak.soak", "--frames", "4000", *tiny]
    done = subprocess.run(command, cwd=ROOT, env=environment(), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Nothing grows." in done.stdout
