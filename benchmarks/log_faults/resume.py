"""One training run killed once or twice, resumed, and compared with the same run that nobody killed."""

import random
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.child import BenchError
from benchmarks.log_faults.blow import CHECKPOINT, LOG, RENAMING, Blow, Watch, places_in, struck_s
from benchmarks.log_faults.same_run import RunContents, differences, read_run
from benchmarks.log_faults.training import TrainingRun, run_path
from carrl.cli.process import INTERRUPTED
from carrl.errors import CarrlError
from carrl.train.checkpoint import PREVIOUS, STATE
from carrl.train.files import CONFIG, load_config

LONGEST_EXIT_S = 5.0
"""How long a run may go on after SIGTERM."""
AGAIN = 0.25
"""How often a run that is resumed is killed once more."""
ANY_MOMENT, FIRST, WRITING, RENAMED, LOGGING = (
    "at any moment",
    "in the middle of writing the first checkpoint",
    "in the middle of writing a checkpoint",
    "at the renaming of a checkpoint",
    "in the middle of a write to the log",
)
MOMENTS = {ANY_MOMENT: 10, FIRST: 2, WRITING: 5, RENAMED: 3, LOGGING: 4}
"""When runs are killed, and how often in comparison."""
MOMENTS_AGAIN = [ANY_MOMENT, WRITING, RENAMED, LOGGING]
_PLACES = {FIRST: CHECKPOINT, WRITING: CHECKPOINT, RENAMED: RENAMING, LOGGING: LOG}
_POLL_S = 0.002


@dataclass(frozen=True)
class Reference:
    """A run that nobody killed.

    Attributes:
        overrides: of Hydra.
        contents: of its folder.
        seconds: from when its folder had a configuration until its end.
        places: how many writes and renamings it made, by kind.
    """

    overrides: Sequence[str]
    contents: RunContents
    seconds: float
    places: Counter[str]


@dataclass
class Resume:
    """What became of a killed run.

    Attributes:
        signal: the name of the first one it got.
        moment: one of `MOMENTS`, of that signal.
        kills: signals that it got before its end.
        ended_before: runs that had ended before their signal came, before this one.
        found: what it had left after the first one: "nothing" to resume, a "configuration", a "checkpoint" or, where
            the latest was gone, the "checkpoint before".
        exit_s: seconds to its end after each SIGTERM.
        faults: whatever is not as it should be, each as a sentence.
    """

    signal: str
    moment: str
    kills: int = 0
    ended_before: int = 0
    found: str = "nothing"
    exit_s: list[float] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)


def run_to_the_end(overrides: Sequence[str]) -> Reference:
    """Trains without a kill.

    Raises:
        BenchError: the run failed.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        run = TrainingRun(folder, overrides, patches=Watch(folder).patches)
        _await_config(run)
        began_s = time.monotonic()
        if run.wait() != 0:
            raise BenchError(f"`carrl train {' '.join(overrides)}` failed: {run.last_words}")
        seconds = time.monotonic() - began_s
        try:
            return Reference(overrides, read_run(run.path), seconds, places_in(folder))
        except (CarrlError, OSError) as error:
            raise BenchError(f"`carrl train {' '.join(overrides)}`: {error}; train one seed, with a log") from error


def kill_and_resume(reference: Reference, number: int, draw: random.Random) -> Resume:
    """Starts the same run again, sends it the signal, resumes it, and compares its end with the reference."""
    ended_before = 0
    while True:
        [moment] = draw.choices(list(MOMENTS), list(MOMENTS.values()))
        resume = Resume(signal.Signals(number).name, moment, ended_before=ended_before)
        with tempfile.TemporaryDirectory() as name:
            _kill(reference, Path(name), number, moment, draw, resume)
            if resume.kills or resume.faults:
                _resume(reference, Path(name), draw, resume)
                return resume
        ended_before += 1


def _resume(reference: Reference, folder: Path, draw: random.Random, resume: Resume) -> None:
    """Goes on with a killed run to its end, which may take another kill."""
    resume.found = _what_is_left(run_path(folder))
    if draw.random() < AGAIN:
        again, moment = draw.choice([signal.SIGTERM, signal.SIGKILL]), draw.choice(MOMENTS_AGAIN)
        _kill(reference, folder, again, moment, draw, resume)
    run = TrainingRun(folder, _how_to_go_on(reference, folder))
    code = run.wait()
    if code != 0:
        resume.faults.append(f"the resumed run ended with code {code}: {run.last_words}")
        return
    try:
        resume.faults += differences(read_run(run.path), reference.contents)
    except (CarrlError, OSError) as error:
        resume.faults.append(f"{type(error).__name__}: {error}")


def _how_to_go_on(reference: Reference, folder: Path) -> Sequence[str]:
    """The overrides that go on with a run, or begin it once more where it left nothing."""
    path = run_path(folder)
    return reference.overrides if _what_is_left(path) == "nothing" else [f"resume={path}"]


def _what_is_left(path: Path) -> str:
    if (path / STATE).exists():
        return "checkpoint"
    if (path / PREVIOUS).exists():
        return "checkpoint before"
    with suppress(CarrlError):
        load_config(path)
        return "configuration"
    return "nothing"


def _kill(
    reference: Reference,
    folder: Path,
    number: int,
    moment: str,
    draw: random.Random,
    resume: Resume,
) -> None:
    """Begins a run or goes on with it, with a signal on the way unless the end comes before it."""
    seconds = draw.uniform(0.0, reference.seconds)
    watch = Watch(folder, _draw_blow(reference, number, moment, draw))
    run = TrainingRun(folder, _how_to_go_on(reference, folder), patches=watch.patches)
    sent_s = None
    if moment == ANY_MOMENT:
        _await_config(run)
        until_s = time.monotonic() + seconds
        while not run.has_ended and time.monotonic() < until_s:
            time.sleep(_POLL_S)
        if not run.has_ended:
            sent_s = time.monotonic()
            run.send(number)
    code = run.wait()
    ended_s = time.monotonic()
    sent_s = sent_s or struck_s(folder)
    resume.kills += sent_s is not None
    if sent_s is not None and number == signal.SIGTERM:
        resume.exit_s.append(ended_s - sent_s)
        if resume.exit_s[-1] > LONGEST_EXIT_S:
            resume.faults.append(f"the run went on for {resume.exit_s[-1]:.1f} s after SIGTERM")
    if code not in (0, INTERRUPTED, -number):
        resume.faults.append(f"the run ended with code {code} after {signal.Signals(number).name}: {run.last_words}")


def _draw_blow(reference: Reference, number: int, moment: str, draw: random.Random) -> Blow | None:
    if moment == ANY_MOMENT:
        return None
    place = _PLACES[moment]
    which = 0 if moment == FIRST else draw.randrange(reference.places[place])
    return Blow(number, place, which, draw.random())


def _await_config(run: TrainingRun) -> None:
    """Waits until there is something to resume, or the run has ended."""
    while not run.has_ended and not (run.path / CONFIG).exists():
        time.sleep(_POLL_S)
