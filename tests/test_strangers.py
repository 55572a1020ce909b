"""Files from strangers are data: none runs a command, hangs, or steers the terminal; each is refused in one line.

Every payload here would create the file `harmed`; the first test shows that it can.
"""

import ast
import json
import os
import pickle
from pathlib import Path

import numpy as np
import pytest
import torch

from carrl.cli.main import main
from carrl.log.writer import LogWriter
from carrl.report.groups import HYDRA, OVERRIDES, SWEEP
from carrl.train.files import CONFIG, METRICS, SUMMARY, checkpoint_path
from tests.logs import make_schema
from tests.operations import count_calls
from tests.strangers import Payload, make_run, proves_harmful, refused

SQUARE = "corners: [[0, 0], [60, 0], [60, 60], [0, 60]]\ncorner_radius: 10\nwidth: 8\n"


def test_the_payload_is_real_and_an_honest_run_is_driven(tmp_path, capsys):
    assert proves_harmful(tmp_path / "harmed")
    assert main(["evaluate", str(make_run(tmp_path / "run")), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["tracks"][0]["track"] == "oval"


# Checkpoints


def test_a_checkpoint_with_a_payload_is_refused(tmp_path, marker, capsys):
    run = make_run(tmp_path / "run")
    for state in (Payload(marker), {"format_version": 1, "network": Payload(marker)}, {"network": [Payload(marker)]}):
        torch.save(state, checkpoint_path(run, "best"))
        assert "best.pt" in refused(capsys, "evaluate", run)
        torch.save(state, checkpoint_path(run, "best"), _use_new_zipfile_serialization=False)
        assert "best.pt" in refused(capsys, "evaluate", run)
        checkpoint_path(run, "best").write_bytes(pickle.dumps(state))
        assert "best.pt" in refused(capsys, "evaluate", run)


@pytest.mark.parametrize(
    "change",
    [
        lambda state: {**state, "more": torch.zeros(1)},
        lambda state: dict(list(state.items())[1:]),
        lambda state: {key: value.double() for key, value in state.items()},
        lambda state: {key: value * float("nan") for key, value in state.items()},
        lambda state: {key: value[:1] for key, value in state.items()},
        lambda state: {key: 1.0 for key in state},
        lambda state: list(state.values()),
        lambda state: None,
    ],
)
def test_a_checkpoint_that_does_not_fit_the_network_is_refused(tmp_path, capsys, change):
    run = make_run(tmp_path / "run")
    state = torch.load(checkpoint_path(run, "best"), weights_only=True)
    torch.save({**state, "network": change(state["network"])}, checkpoint_path(run, "best"))
    assert "does not fit the network" in refused(capsys, "evaluate", run)


# Tracks


def test_a_track_with_a_payload_is_refused(tmp_path, marker, capsys):
    np.save(tmp_path / "a.npy", np.array([[Payload(marker)] * 6] * 4, dtype=object), allow_pickle=True)
    (tmp_path / "b.npy").write_bytes(pickle.dumps(Payload(marker)))
    np.savez(tmp_path / "c.npz", points=np.array([Payload(marker)], dtype=object))
    (tmp_path / "c.npz").rename(tmp_path / "c.npy")
    (tmp_path / "d.yaml").write_text(f"{SQUARE}gates: !!python/object/apply:os.system ['touch {marker}']\n")
    (tmp_path / "e.csv").write_bytes(pickle.dumps(Payload(marker)))
    (tmp_path / "f.csv").write_text(f"# x_m,y_m,w_tr_right_m,w_tr_left_m\n=cmd|'touch {marker}'!A0,0,4,4\n")
    run = make_run(tmp_path / "run")
    for name in ("a.npy", "b.npy", "c.npy", "d.yaml", "e.csv", "f.csv"):
        for verb in (["track", "check"], ["track", "show"], ["evaluate", run, "--track"]):
            assert f"track '{name}': " in refused(capsys, *verb, tmp_path / name)


@pytest.mark.parametrize(
    "tag", ["!!bool maybe", "!!int ''", "!!float ''", "!!timestamp never", "!!binary x", "!!omap 5"]
)
def test_a_drawing_with_a_tag_that_does_not_fit_is_refused(tmp_path, capsys, tag):
    (tmp_path / "a.yaml").write_text(f"{SQUARE}gates: {tag}\n")
    assert "track 'a.yaml': " in refused(capsys, "track", "check", tmp_path / "a.yaml")


def ring(points, turns, width):
    angle = 2 * np.pi * turns * np.arange(points) / points
    rows = [f"{1000 * np.cos(a):.3f},{1000 * np.sin(a):.3f},{width},{width}" for a in angle]
    return "\n".join(["# x_m,y_m,w_tr_right_m,w_tr_left_m", *rows, ""])


def test_a_road_that_crosses_itself_millions_of_times_is_refused_at_once(tmp_path, capsys):
    (tmp_path / "a.csv").write_text(ring(5001, 1000, 5))
    assert "crosses itself more than" in refused(capsys, "track", "check", tmp_path / "a.csv")


def test_a_road_of_too_many_points_is_refused_at_once(tmp_path, capsys):
    (tmp_path / "a.csv").write_text("# x_m,y_m,w_tr_right_m,w_tr_left_m\n" + "1,2,3,4\n" * 110_000)
    assert "more than 100000 points" in refused(capsys, "track", "check", tmp_path / "a.csv")
    np.save(tmp_path / "a.npy", np.zeros((110_000, 6)))
    assert "at most 100000 points" in refused(capsys, "track", "check", tmp_path / "a.npy")


def test_millions_of_faults_are_told_with_little_work(tmp_path, capsys):
    (tmp_path / "a.csv").write_text(ring(1500, 1, 5000))
    assert count_calls(lambda: main(["track", "check", str(tmp_path / "a.csv")])) < 2_000_000
    assert "more places" in capsys.readouterr().out


# Logs


def test_a_log_with_payloads_is_read_as_data(tmp_path, marker, capsys):
    program = f"!!python/object/apply:os.system ['touch {marker}']".encode()
    attachments = {
        "config.yaml": program,
        "track.json": pickle.dumps(Payload(marker)),
        "../harmed": b"",
        str(marker): b"",
        "\x1b[2J": b"",
    }
    entries = {"action_names": f"__import__('os').system('touch {marker}')", "\x1b]0;x\x07": "\x1b[31m"}
    with LogWriter(tmp_path / "a.mcap", schema=make_schema(), attachments=attachments, metadata=entries):
        pass
    for verb in (["info"], ["ls"], ["stats"], ["check"], ["recover"], ["cat"], ["show"], ["replay", "--no-open"]):
        more = [tmp_path / "mended.mcap"] if verb == ["recover"] else []
        assert main(["log", *verb[:1], str(tmp_path / "a.mcap"), *map(str, more), *verb[1:]]) in (0, 2)
        printed = capsys.readouterr()
        assert "\x1b" not in printed.out + printed.err


def test_a_pickle_that_is_called_a_log_is_refused(tmp_path, marker, capsys):
    (tmp_path / "a.mcap").write_bytes(pickle.dumps(Payload(marker)))
    for verb in ("info", "ls", "show", "stats", "cat"):
        assert "is not an MCAP file" in refused(capsys, "log", verb, tmp_path / "a.mcap")


# Results


def named_damaged(capsys, run):
    """What the report says of a run whose results are damaged; there are still others, so it is no error."""
    capsys.readouterr()
    assert main(["report", str(run)]) == 0
    (line,) = [line for line in capsys.readouterr().out.splitlines() if "damaged" in line and line.startswith("- ")]
    assert line.isprintable()
    return line


RESULTS = '{"episodes": 1200, "frames": 1, "updates": 1, "wall_time_s": 1, "first_lap": null, "evaluation": null}'


@pytest.mark.parametrize(
    "summary",
    [
        "[]",
        '"x"',
        "5",
        "null",
        "{",
        "{}",
        "[" * 100_000,
        "NaN",
        '{"episodes": 1e999}',
        '{"episodes": ' + "9" * 5000 + "}",
        '{"episodes": 1, "frames": 1, "first_lap": [], "evaluation": null}',
        '{"episodes": 1, "frames": 1, "first_lap": null, "evaluation": {"lap_completed": 1}}',
        '{"episodes": "1", "frames": 1, "first_lap": null, "evaluation": null}',
    ],
)
def test_a_summary_of_another_shape_is_named(tmp_path, capsys, summary):
    run = make_run(tmp_path / "run")
    (run / SUMMARY).write_text(summary)
    assert "summary.json is damaged" in named_damaged(capsys, run)


@pytest.mark.parametrize(
    "table",
    [
        "episode\n1\n",
        "episode_return\nx\n",
        "episode_return\nnan\n",
        "a,episode_return\n1\n",
        "episode_return\n" + "9" * 200_000 + "\n",
        'episode_return\n"\n' + "a" * 200_000,
        "\0\n\0\n",
    ],
)
def test_metrics_of_another_shape_are_named(tmp_path, capsys, table):
    run = make_run(tmp_path / "run")
    (run / SUMMARY).write_text(RESULTS)
    (run / METRICS).write_text(table)
    assert "metrics.csv is damaged" in named_damaged(capsys, run)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        (str(CONFIG), "more: &a {b: *a}"),
        (str(HYDRA), "hydra: {runtime: {choices: {loss: &a [*a]}}}"),
        (str(HYDRA), "[" * 100 + "]" * 100),
        (str(OVERRIDES), "&a [*a]"),
        (SWEEP, "&a {hydra: *a, overrides: {task: *a}}"),
    ],
)
def test_a_note_that_holds_itself_does_not_end_the_report(tmp_path, capsys, name, text):
    (make_run(tmp_path / "whole") / SUMMARY).write_text(RESULTS)
    run = make_run(tmp_path / "run")
    (run / SUMMARY).write_text(RESULTS)
    before = (run / name).read_text() if (run / name).exists() else ""
    (run / name).write_text(before + text)
    assert main(["report", str(tmp_path)]) == 0
    assert "whole" in capsys.readouterr().out


@pytest.mark.parametrize("seeds", ["range(0,4000000000)", "shuffle(range(0,4000000000))"])
def test_a_sweep_of_billions_of_jobs_is_not_counted_out(tmp_path, capsys, seeds):
    (make_run(tmp_path / "run") / SUMMARY).write_text(RESULTS)
    (tmp_path / SWEEP).write_text(f"hydra: {{overrides: {{task: ['seed={seeds}', 'threads=1,2']}}}}")
    assert main(["report", str(tmp_path)]) == 0
    assert "more than 65536 jobs" in capsys.readouterr().out


def test_a_run_without_an_evaluation_is_a_row_with_dashes(tmp_path, capsys):
    run = make_run(tmp_path / "run")
    (run / SUMMARY).write_text(RESULTS)
    assert main(["report", str(run)]) == 0
    assert "| 1,200 | 1 | never | never | - | - |" in capsys.readouterr().out


# Places that are no files, and names


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes here")
def test_a_pipe_or_a_device_in_the_place_of_a_file_is_refused_at_once(tmp_path, capsys):
    run = make_run(tmp_path / "run")
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "zero.yaml").symlink_to("/dev/zero")
    for path in (tmp_path / "pipe.csv", tmp_path / "zero.yaml"):
        assert "not a regular file" in refused(capsys, "track", "check", path)
        assert "not a regular file" in refused(capsys, "log", "info", path)
    (run / SUMMARY).write_text(RESULTS)
    for place in (METRICS, SUMMARY, CONFIG):
        (run / place).unlink(missing_ok=True)
        os.mkfifo(run / place)
        assert "not a regular file" in (
            refused(capsys, "evaluate", run) if place == CONFIG else named_damaged(capsys, run)
        )
        (run / place).unlink()


@pytest.mark.parametrize("name", ["a" * 5000, "a\0b", "\x1b[2J", "nothing"])
def test_a_name_of_no_run_is_refused_by_every_verb(tmp_path, capsys, name):
    capsys.readouterr()
    for verb in ("evaluate", "report"):
        assert main([verb, str(tmp_path / name)]) == 2
        printed = capsys.readouterr().err
        assert printed.count("\n") == 1
        assert printed[:-1].isprintable()


def test_names_do_not_steer_the_terminal_nor_style_its_text(tmp_path, capsys):
    name = "\x1b[31m[bold]|$x^$"
    run = make_run(tmp_path / name)
    (tmp_path / f"{name}.yaml").write_text(SQUARE)
    track = str(tmp_path / f"{name}.yaml")
    for arguments in (["evaluate", run, "--track", track], ["report", run], ["track", "check", track]):
        assert main(list(map(str, arguments))) == 0
        printed = capsys.readouterr().out
        assert "\x1b" not in printed
        assert "[bold]" in printed
    assert main(["track", "show", track, "--out", str(tmp_path / "map.png")]) == 0


SERVERS = {"socket", "socketserver", "http", "http.server", "asyncio", "xmlrpc", "wsgiref", "multiprocessing.managers"}


@pytest.mark.parametrize("path", sorted(Path("carrl").rglob("*.py")), ids=str)
def test_no_module_can_open_a_port_by_itself(path):
    """What listens is Rerun's viewer, as tests/render watch, and Ray, as tests/data watch."""
    tree = ast.parse(path.read_text())
    imported = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    imported |= {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module}
    asks_for_addresses = {"socket"} if path.name == "cluster_collector.py" else set()
    assert not imported & (SERVERS - asks_for_addresses)
    assert not any(word in path.read_text() for word in ("0.0.0.0", "serve_grpc", "serve_web", "rr.spawn"))
