"""Which episode a verb shows that shows one."""

import math

import numpy as np

from carrl.errors import LogError
from carrl.log.codec import Selection
from carrl.log.messages import Episode
from carrl.log.reader import Log
from carrl.log.trace import EpisodeTrace, read_trace


def best_first(episode: Episode) -> float:
    """What to sort by to have the highest return first."""
    return math.inf if math.isnan(episode.episode_return) else -episode.episode_return


def choose_trace(log: Log, episode: int | None) -> EpisodeTrace:
    """The episode of this number; for None that with the highest return of all whose transitions the log has.

    Raises:
        LogError: the log does not have it, or has none.
        DamagedLogError: it is not an intact log.
    """
    ended = [message.episode for message in sorted(log.episodes(), key=best_first)]
    if episode is None:
        return read_trace(log, _first_recorded(log, ended))
    if not _is_recorded(log, episode):
        raise LogError(f"log '{log.path}': {_absence(episode, ended)}")
    return read_trace(log, episode)


def _first_recorded(log: Log, ended: list[int]) -> int:
    """The first of the ended episodes that has transitions, most often the very first."""
    if ended and _is_recorded(log, ended[0]):
        return ended[0]
    recorded = _recorded(log)
    if not recorded:
        raise LogError(f"log '{log.path}': holds no transitions; give the log of a run that recorded some")
    for episode in ended:
        if episode in recorded:
            return episode
    raise LogError(
        f"log '{log.path}': no episode in it is recorded up to its end; "
        f"choose an unfinished one, such as --episode {min(recorded)}"
    )


def _is_recorded(log: Log, episode: int) -> bool:
    return next(log.batches(Selection(episodes=[episode])), None) is not None


def _recorded(log: Log) -> set[int]:
    """Every episode of which the log has a transition."""
    return {int(episode) for columns in log.batches() for episode in np.unique(columns["episode"])}


def _absence(episode: int, ended: list[int]) -> str:
    """Why an episode cannot be shown, and which can."""
    if episode in ended:
        return (
            f"notes the end of episode {episode} but has no transition of it, for recorder.envs or "
            "recorder.every_nth_episode left it out, or it lies in another part of the log; choose another one"
        )
    if not ended:
        return f"has no transition of episode {episode}, nor did any episode end in it"
    return f"has no episode {episode}; those that ended are in {min(ended)}..{max(ended)}, see carrl log ls FILE"
