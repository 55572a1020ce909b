"""`scripts/bench train`: how fast CarRL trains, beside Stable-Baselines3 and a plain PyTorch loop."""

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

from benchmarks import figures, profiling, recipes
from benchmarks.child import BenchError
from benchmarks.contestants import CONTESTANTS, DQN_CONTESTANTS, MINIMUM_FRAMES, SB3, Contestant
from benchmarks.figures import Measurement
from benchmarks.machine import describe_machine, machine_line
from benchmarks.options import Parser, names_of, positive, tell, writable

PROFILED = ("compiled", "compiled-ten")
NOTES = (
    "One thread each, and one update for each env step: DQN's of a 16-16-8 network on 128 transitions; those of SAC, "
    "TD3 and DDPG on 256, with the layers that are named, beside Stable-Baselines3's own.",
    "CarRL: the run as it is typed, with its log of every transition and its greedy drives; without imports.",
    "Stable-Baselines3: `learn` alone, without logger or callbacks, with torch's fused Adam as in CarRL.",
    "CleanRL's own package (cleanrl 0.4.8) does not start with the gym that pip picks for it, knows only old Gym "
    "environments and has its layer sizes written into the code; the plain loop stands in for it.",
)
Table = Callable[[Sequence[str], Sequence[Sequence[str]]], str]


def main(argv: list[str] | None = None) -> int:
    """Measures and prints; returns 0, or 1 where a contestant failed."""
    arguments = _parse(argv)
    result: dict[str, Any] = {"machine": describe_machine(), "scale": arguments.scale}
    table = figures.markdown_table if arguments.markdown else figures.plain_table
    print(machine_line(result["machine"]) + "\n")
    try:
        if not arguments.no_race:
            result["speed"] = _race([CONTESTANTS[name] for name in arguments.only], arguments, table)
        if arguments.recipes:
            result["recipes"] = _time_recipes(arguments.recipe_seeds, table)
        if arguments.profile:
            result["profile"] = _profile(arguments.scale, table)
        code = 0
    except BenchError as error:
        print(f"scripts/bench train: {error}", file=sys.stderr)
        code = 1
    except KeyboardInterrupt:
        code = 130
    if arguments.json:  # also what was measured before something failed
        arguments.json.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    return code


def _parse(argv: list[str] | None) -> argparse.Namespace:
    parser = Parser(prog="scripts/bench train", description=__doc__)
    names = ", ".join(CONTESTANTS)
    parser.add_argument("--rounds", type=positive(int), default=3, metavar="N", help="of all contestants in turn")
    parser.add_argument(
        "--only",
        type=names_of(list(CONTESTANTS)),
        default=DQN_CONTESTANTS,
        metavar="NAME,...",
        help=f"contestants, of: {names}; by default those of DQN",
    )
    parser.add_argument(
        "--scale",
        type=positive(float),
        default=1.0,
        metavar="X",
        help="times the env steps; 0.1 for a quick look, in which fixed costs weigh more",
    )
    parser.add_argument("--recipes", action="store_true", help="also time each recipe to its first greedy lap")
    parser.add_argument("--recipe-seeds", type=positive(int), default=3, metavar="N", help="seeds 0 to N-1 of each")
    parser.add_argument("--profile", action="store_true", help="also show where CarRL's time goes")
    parser.add_argument("--no-race", action="store_true", help="only what --recipes and --profile ask for")
    parser.add_argument("--markdown", action="store_true", help="print tables for a page")
    parser.add_argument("--json", type=writable, metavar="FILE", help="keep all figures, of every round")
    arguments = parser.parse_args(argv)
    if arguments.no_race and not (arguments.recipes or arguments.profile):
        parser.error("--no-race leaves nothing to do; add --recipes or --profile")
    return arguments


def _race(contestants: Sequence[Contestant], arguments: argparse.Namespace, table: Table) -> dict[str, Any]:
    """Measures all contestants in turn, round after round, and prints the table."""
    for contestant in contestants:  # fills the caches of compiled code, and finds early what does not run
        tell(f"warm-up: {contestant.title}")
        contestant.measure(MINIMUM_FRAMES)
    rounds: dict[str, list[Measurement]] = {contestant.title: [] for contestant in contestants}
    for number in range(1, arguments.rounds + 1):
        for contestant in contestants:
            measured = contestant.measure(max(MINIMUM_FRAMES, round(contestant.frames * arguments.scale)))
            rounds[contestant.title].append(measured)
            tell(f"round {number} of {arguments.rounds}: {contestant.title}: {measured.frames_per_s:,.0f} frames/s")
    reference = figures.fastest(rounds, list(SB3.values()))
    peers = {each.title: each.peer if each.peer in rounds else None for each in contestants if each.peer}
    print(table(figures.HEADER, [figures.speed_row(title, rounds, peers.get(title, reference)) for title in rounds]))
    print(f"\nMedians of {arguments.rounds} interleaved rounds; frames, updates and seconds are the median round's.")
    if reference is not None:
        print(f"'times SB3' is against {reference}, its fastest form measured here; 'by round': min..max.")
    print("\n".join(NOTES) + "\n")
    return {"reference": reference, "rounds": {title: [asdict(each) for each in own] for title, own in rounds.items()}}


def _time_recipes(seeds: int, table: Table) -> dict[str, Any]:
    found = recipes.time_recipes(seeds)
    rows = [recipes.recipe_row(name, state, laps) for name, by in found.items() if by for state, laps in by.items()]
    print(table(recipes.HEADER, rows))
    print("\nFrom the start of the process; median (min..max) over the seeds that lapped.")
    print("Cold: caches of compiled code empty; warm: the same seed again.")
    for recipe in (name for name, by in found.items() if by is None):
        print(f"Left out: {recipe}, for there is no conf/experiment/{recipe}.yaml.")
    print()
    return {
        name: by and {state: [lap and asdict(lap) for lap in laps] for state, laps in by.items()}
        for name, by in found.items()
    }


def _profile(scale: float, table: Table) -> dict[str, list[list[str]]]:
    found = {}
    for contestant in (CONTESTANTS[name] for name in PROFILED):
        tell(f"profile: {contestant.title}")
        frames = max(MINIMUM_FRAMES, round(contestant.frames * scale))
        found[contestant.title] = profiling.profile_rows(True, contestant.seeds, frames)
        print(f"{contestant.title}, {frames:,} env steps a seed. CPU time by the package at work, start-up included:\n")
        print(table(profiling.HEADER, found[contestant.title]) + "\n")
    return found


if __name__ == "__main__":
    sys.exit(main())
