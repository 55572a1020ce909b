"""Which signals end training, and what a second one does."""

import os
import pty
import signal
from contextlib import contextmanager

import pytest

from carrl.cli.process import heeded, let_go_of_closed_terminal
from carrl.cli.text.console import StopOnSignals


class Trainer:
    stopping = False

    def interrupt(self):
        self.stopping = True


@contextmanager
def stopping_on_signals(trainer):
    observer = StopOnSignals()
    observer.on_start(trainer)
    try:
        yield
    finally:
        observer.on_end()


class EndedError(Exception):
    """What stands for the end of the process."""


@pytest.fixture(autouse=True)
def _in_the_foreground():
    """Signals that the tests' own process ignores, as in the background or under nohup, would stay ignored."""
    defaults = {
        signal.SIGINT: signal.default_int_handler,
        signal.SIGTERM: signal.SIG_DFL,
        signal.SIGHUP: signal.SIG_DFL,
    }
    before = {number: signal.signal(number, handler) for number, handler in defaults.items()}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def at_its_end(monkeypatch):
    def end(code):
        raise EndedError(code)

    monkeypatch.setattr(os, "_exit", end)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_second_signal_ends_the_process_at_once(number, at_its_end):
    with stopping_on_signals(Trainer()) as _, pytest.raises(EndedError, match="130"):
        signal.raise_signal(number)
        signal.raise_signal(number)


def test_a_second_sighup_is_passed_over_since_a_closing_terminal_sends_two(at_its_end):
    trainer = Trainer()
    with stopping_on_signals(trainer):
        signal.raise_signal(signal.SIGHUP)
        signal.raise_signal(signal.SIGHUP)
        assert trainer.stopping
        with pytest.raises(EndedError):
            signal.raise_signal(signal.SIGTERM)


def test_under_nohup_sighup_stays_ignored():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        trainer = Trainer()
        with stopping_on_signals(trainer):
            signal.raise_signal(signal.SIGHUP)
        assert not trainer.stopping
        assert signal.SIGHUP not in heeded()
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_closed_terminal_is_let_go_of_and_an_open_one_is_kept():
    kept, (master, terminal) = os.dup(2), pty.openpty()
    try:
        os.dup2(terminal, 2)
        let_go_of_closed_terminal()
        assert os.isatty(2)
        os.close(master)
        with pytest.raises(OSError, match="Input/output error"):
            os.write(2, b"progress")
        let_go_of_closed_terminal()
        assert os.write(2, b"progress") == len(b"progress")
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(terminal)
