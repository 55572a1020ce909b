"""What came of races: who was first in each, and a league table over several."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from carrl.evaluation.intervals import rate_interval
from carrl.evaluation.results import LEAST_KM, rounded

ELO_START, ELO_STEP = 1000.0, 16.0
"""The rating before the first race, and by how much one result between two cars may change it."""


@dataclass(frozen=True)
class Result:
    """What a car did in a race.

    Attributes:
        car: its name.
        start: its place at the start, from 1.
        ended: `finished`, `wall` or `car` where touching one took it off the road, or `time` where its time was up.
        time: to the end of its last lap, s; None unless it finished.
        way: past the start line in the end, m.
        best_lap: s; None if it completed none.
        overtakes: places won from cars on the road; a place that is lost and won again counts twice.
        driven_km: km.
        contacts_own: with cars, into which it drove with its front; None of an opponent.
        contacts_others: with cars otherwise; None of an opponent.
    """

    car: str
    start: int
    ended: str
    time: float | None
    way: float
    best_lap: float | None
    overtakes: int
    driven_km: float
    contacts_own: int | None
    contacts_others: int | None


@dataclass(frozen=True)
class Race:
    """A race.

    Attributes:
        track: its name.
        start: station of the start line, m.
        results: in finishing order.
    """

    track: str
    start: float
    results: tuple[Result, ...]

    @classmethod
    def of(cls, track: str, start: float, results: Sequence[Result]) -> "Race":
        """The cars in finishing order: by their times, then those that did not finish by how far they came."""
        ranked = sorted(results, key=lambda each: (each.time is None, each.time or -each.way))
        return cls(track, start, tuple(ranked))

    def place(self, car: str) -> int:
        """Of a car, from 1."""
        return 1 + [result.car for result in self.results].index(car)

    def measures(self) -> dict[str, Any]:
        """All of it, ready for JSON."""
        rows = [
            {
                "place": place,
                **asdict(result),
                "time": rounded(result.time),
                "best_lap": rounded(result.best_lap),
                **_per_km(result.contacts_own, result.contacts_others, result.driven_km),
            }
            for place, result in enumerate(self.results, start=1)
        ]
        return {"track": self.track, "start_m": self.start, "cars": rows}


def _per_km(own: int | None, others: int | None, driven_km: float) -> dict[str, float]:
    """Contacts per km, of cars whose contacts are known."""
    counts = {"contacts_own_per_km": own, "contacts_others_per_km": others}
    return {name: count / max(driven_km, LEAST_KM) for name, count in counts.items() if count is not None}


def league(races: Sequence[Race]) -> list[dict[str, Any]]:
    """How each car did over all races, ready for JSON, the best mean place first; ratings are those after the last."""
    ratings = elo(races)
    names = [result.car for result in sorted(races[0].results, key=lambda result: result.start)]
    rows = [_over_all(name, races) | {"elo": round(ratings[name], 1)} for name in names]
    return sorted(rows, key=lambda row: row["mean_place"])


def _over_all(car: str, races: Sequence[Race]) -> dict[str, Any]:
    own = [next(result for result in race.results if result.car == car) for race in races]
    places = [race.place(car) for race in races]
    driven_km = math.fsum(result.driven_km for result in own)
    laps = [result.best_lap for result in own if result.best_lap is not None]
    found: dict[str, Any] = {
        "car": car,
        "races": len(races),
        "wins": sum(place == 1 and result.time is not None for place, result in zip(places, own, strict=True)),
        "finished": sum(result.time is not None for result in own),
        "mean_place": math.fsum(places) / len(places),
        "places_won": math.fsum(result.start - place for result, place in zip(own, places, strict=True)) / len(own),
        "overtakes": sum(result.overtakes for result in own),
        "best_lap": rounded(min(laps, default=None)),
        "driven_km": driven_km,
    }
    if own[0].contacts_own is None:
        return found
    counts = [sum(getattr(result, f"contacts_{fault}") for result in own) for fault in ("own", "others")]
    return {
        **found,
        "contacts_own": counts[0],
        "contacts_others": counts[1],
        **_per_km(counts[0], counts[1], driven_km),
        "intervals": {"contacts_own_per_km": rate_interval(counts[0], max(driven_km, LEAST_KM))},
    }


def elo(races: Sequence[Race]) -> dict[str, float]:
    """The rating of each car after races in this order.

    Of each two cars of a race the one that was ahead has beaten the other. All results of a race count at once, against
    the ratings before it.

    Source: Elo 1978, "The Rating of Chessplayers, Past and Present", section 1.6.
    """
    ratings = {result.car: ELO_START for result in races[0].results}
    for race in races:
        before = dict(ratings)
        order = [result.car for result in race.results]
        for place, winner in enumerate(order):
            for loser in order[place + 1 :]:
                expected = 1 / (1 + 10 ** ((before[loser] - before[winner]) / 400))
                ratings[winner] += ELO_STEP * (1 - expected)
                ratings[loser] -= ELO_STEP * (1 - expected)
    return ratings
