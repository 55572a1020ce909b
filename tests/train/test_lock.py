"""The lock on a folder, and folders made for new runs."""

import errno
import fcntl
import multiprocessing
import os
import threading
import time

import pytest

from carrl.errors import CarrlError
from carrl.train.new_folder import LOCK, locked, make_new


def hold(folder, ready):
    with locked(folder):
        ready.send(os.getpid())
        time.sleep(600)


@pytest.fixture
def holder(tmp_path):
    """Another process that has locked the folder."""
    here, there = multiprocessing.Pipe()
    process = multiprocessing.get_context("spawn").Process(target=hold, args=(tmp_path, there), daemon=True)
    process.start()
    assert here.poll(60)
    assert here.recv() == process.pid
    yield process
    process.kill()
    process.join()


def test_a_lock_names_its_holder_and_ends_with_it_even_by_kill_9(holder, tmp_path):
    with (
        pytest.raises(CarrlError, match=f"'{tmp_path}' is in use by process {holder.pid}; wait until"),
        locked(tmp_path),
    ):
        pass
    holder.kill()
    holder.join()
    assert (tmp_path / LOCK).exists()
    with locked(tmp_path):
        assert (tmp_path / LOCK).read_text().split()[0] == str(os.getpid())
    assert not (tmp_path / LOCK).exists()


def test_a_lock_holds_within_a_process_too_and_is_gone_after_an_error(tmp_path):
    def fail():
        with locked(tmp_path / "run"):
            with pytest.raises(CarrlError, match="is in use"), locked(tmp_path / "run"):
                pass
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert os.listdir(tmp_path / "run") == []


def test_a_lock_that_its_holder_removes_while_it_is_taken_is_taken_anew(tmp_path, monkeypatch):
    flock, calls = fcntl.flock, []

    def late(descriptor, operation):
        calls.append(descriptor)
        if len(calls) == 1:
            (tmp_path / LOCK).unlink()  # as the holder before does at its end
        flock(descriptor, operation)

    monkeypatch.setattr(fcntl, "flock", late)
    with locked(tmp_path), pytest.raises(CarrlError, match="is in use"), locked(tmp_path):
        pass
    assert len(calls) == 3


def test_the_lock_of_a_folder_that_took_the_places_of_a_moved_one_is_left(tmp_path):
    with locked(tmp_path / "run"):
        (tmp_path / "run").rename(tmp_path / "moved")
        (tmp_path / "run").mkdir()
        (tmp_path / "run" / LOCK).write_text("1 elsewhere\n")
    assert (tmp_path / "run" / LOCK).exists()


def test_a_holder_on_another_machine_is_named_with_it(tmp_path, monkeypatch):
    with locked(tmp_path):
        monkeypatch.setattr("platform.node", lambda: "another")
        host = (tmp_path / LOCK).read_text().split()[1]
        with pytest.raises(CarrlError, match=f"process {os.getpid()} on {host};"), locked(tmp_path):
            pass


def test_a_file_system_without_locks_is_used_with_a_warning(tmp_path, monkeypatch, caplog):
    def refuse(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", refuse)
    with locked(tmp_path):
        assert (tmp_path / LOCK).exists()
    assert "cannot be locked (No locks available)" in caplog.text


@pytest.mark.parametrize("kind", ["folder", "pipe", "link"])
def test_a_lock_that_is_no_file_is_refused_and_not_followed(kind, tmp_path):
    path = tmp_path / LOCK
    {"folder": path.mkdir, "pipe": lambda: os.mkfifo(path), "link": lambda: path.symlink_to(tmp_path / "target")}[
        kind
    ]()
    with pytest.raises(CarrlError, match=f"'{tmp_path}' cannot be written: {LOCK}"), locked(tmp_path):
        pass
    assert os.listdir(tmp_path) == [LOCK]


def test_a_file_cannot_be_locked_as_a_folder(tmp_path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(CarrlError, match="is not a folder; name one"), locked(tmp_path / "file"):
        pass
    assert (tmp_path / "file").read_text() == "mine"


def test_who_waits_for_a_lock_gets_it_when_its_holder_ends(holder, tmp_path):
    threading.Timer(0.2, holder.kill).start()
    with locked(tmp_path, waiting=True):
        assert (tmp_path / LOCK).read_text().split()[0] == str(os.getpid())


def test_what_a_lock_file_says_cannot_play_tricks_on_the_terminal(tmp_path):
    path = tmp_path / LOCK
    path.write_bytes(b"\x1b[2J" + b"9" * 10_000)
    descriptor = os.open(path, os.O_RDWR)
    fcntl.flock(descriptor, fcntl.LOCK_EX)
    with pytest.raises(CarrlError) as caught, locked(tmp_path):
        pass
    os.close(descriptor)
    assert "\x1b" not in str(caught.value)
    assert len(str(caught.value)) < 500


def test_new_folders_never_meet(tmp_path):
    names = [make_new(tmp_path / "day" / "12-00-00").name for _ in range(3)]
    assert names == ["12-00-00", "12-00-00-2", "12-00-00-3"]


def test_a_new_folder_that_cannot_be_made_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(CarrlError, match="cannot be made: Not a directory"):
        make_new(tmp_path / "file" / "deeper" / "run")
    with pytest.raises(CarrlError, match="cannot be made: "):
        make_new(tmp_path / "file" / "run")
