"""The `carrl` command: finds the verb, runs it, turns a user's mistake into one sentence and exit code 2."""

import importlib
import os
import sys

from carrl.errors import CarrlError
from carrl.printable import printable

VERBS = {
    "train": "train a policy (Hydra overrides: carrl train seed=1 track=oval)",
    "tune": "search for the settings that do best (carrl tune experiment=tune --trials 20)",
    "evaluate": "drive a trained policy, or a baseline, and report how well it drives",
    "drive": "drive a track yourself, with the keyboard",
    "report": "compare runs: tables, figures, and which differences are significant",
    "log": "look into a run's MCAP log",
    "track": "list, draw, check and make up tracks",
}
_VERB_LINES = "\n".join(f"  {verb:<10}{what}" for verb, what in VERBS.items())
USAGE = f"usage: carrl VERB ...\n\n{_VERB_LINES}\n\ncarrl VERB --help tells more."


def main(argv: list[str] | None = None) -> int:
    """Runs one verb and returns the process's exit code: 0 done, 1 a check failed, 2 bad input, 130 interrupted."""
    arguments = sys.argv[1:] if argv is None else argv
    verb = arguments[0] if arguments else "--help"
    if verb in ("-h", "--help"):
        print(USAGE)
        return 0
    if verb not in VERBS:
        print(f"carrl: no verb {verb!r}; choose one of: {', '.join(VERBS)}", file=sys.stderr)
        return 2
    try:
        return importlib.import_module(f"carrl.cli.{verb}").main(arguments[1:])
    except CarrlError as error:
        print(f"carrl: {printable(str(error))}", file=sys.stderr)  # a message may name what a file holds
        return 2
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:  # `carrl log info FILE | head`: the reader has what it wanted
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


if __name__ == "__main__":
    sys.exit(main())
