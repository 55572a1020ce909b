"""The `carrl` command: finds the verb, runs it, turns a user's mistake into one sentence and exit code 2."""

import importlib
import sys
from contextlib import suppress

import carrl
from carrl.cli.process import OutputClosedError, guarded_output
from carrl.errors import CarrlError, printable

VERBS = {
    "train": "train a policy (Hydra overrides: carrl train seed=1 track=oval)",
    "tune": "search for the settings that do best (carrl tune experiment=tune --trials 20)",
    "evaluate": "drive a trained policy, or a baseline, and report how well it drives",
    "race": "race trained policies against each other, or against opponents",
    "watch": "watch a trained car drive, in a window, as a page or as a video",
    "laps": "compare laps of a track: a replay against each other, and the gap over the way",
    "export": "write a trained policy as ONNX, a torch program, arrays or C",
    "drive": "drive a track yourself, with the keyboard",
    "report": "compare runs: tables, figures, and which differences are significant",
    "log": "look into a run's MCAP log",
    "track": "list, draw, check and make up tracks",
    "doctor": "check this installation, and say what to install for what is missing",
}
_VERB_LINES = "\n".join(f"  {verb:<10}{what}" for verb, what in VERBS.items())
USAGE = f"""usage: carrl VERB ...

{_VERB_LINES}

carrl VERB --help tells more; carrl --version names the version.
Tab completion: eval "$(carrl --shell-completion bash)", or zsh; carrl --shell-completion fish | source"""
WELCOME = """CarRL trains cars to drive from a handful of distance sensors. The commands that matter most:

  carrl train experiment=fast          train a network, in a minute; its results are in a folder, RUN
  carrl evaluate RUN --track oval      drive it on another track
  carrl watch RUN                      watch it drive; --out FILE.html without a window
  carrl report DIR                     compare the runs in a folder
  carrl track show FILE.csv            draw a track of your own, for carrl train track=FILE.csv

carrl --help lists all verbs; carrl doctor says what this machine lacks."""


def main(argv: list[str] | None = None) -> int:
    """Runs one verb and returns the process's exit code: 0 done, 1 a check failed, 2 bad input, 130 interrupted."""
    arguments = sys.argv[1:] if argv is None else argv
    exit_code = 0
    try:
        with guarded_output():
            exit_code = _run(arguments)
    except OutputClosedError:  # `carrl log info FILE | head`: the reader has what it wanted
        pass
    except CarrlError as error:
        _complain(str(error))
        return 2
    except KeyboardInterrupt:
        return 130
    return exit_code


def _run(arguments: list[str]) -> int:
    if not arguments:
        print(WELCOME)
        return 0
    verb = arguments[0]
    if verb in ("-h", "--help", "--version") and len(arguments) > 1:
        raise CarrlError(f"'{arguments[1]}' has no effect beside {verb}; leave it out, or type carrl VERB --help")
    if verb in ("-h", "--help"):
        print(USAGE)
        return 0
    if "--version" in arguments:
        print(f"carrl {carrl.__version__}")
        return 0
    if verb in ("--shell-completion", "--complete"):
        from carrl.cli.completion import complete, print_script

        return complete(arguments[1:]) if verb == "--complete" else print_script(arguments[1:])
    if verb not in VERBS:
        from carrl.errors import did_you_mean

        close = did_you_mean(verb, (*VERBS, "--version", "--help", "--shell-completion"))
        raise CarrlError(f"no verb {verb!r}{close or ';'} choose one of: {', '.join(VERBS)}")
    exit_code: int = importlib.import_module(f"carrl.cli.{verb}").main(arguments[1:])
    return exit_code


def _complain(message: str) -> None:
    """Prints a message, which may name what a file holds, if anybody listens."""
    with suppress(OSError, ValueError, AttributeError):
        print(f"carrl: {printable(message)}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
