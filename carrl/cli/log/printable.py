"""Text that a log holds, made harmless for a terminal."""

import dataclasses

from carrl.record.scene import Scene
from carrl.record.trace import EpisodeTrace


def printable(text: str) -> str:
    """The text with every character that could steer a terminal, or hide in it, written as Python would escape it."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def printable_scene(scene: Scene) -> Scene:
    """The same world with printable names."""
    return dataclasses.replace(
        scene,
        action_names=tuple(map(printable, scene.action_names)),
        reward_terms=tuple(map(printable, scene.reward_terms)),
        tracks=tuple(dataclasses.replace(track, name=printable(track.name)) for track in scene.tracks),
    )


def printable_trace(trace: EpisodeTrace) -> EpisodeTrace:
    """The same episode in a world with printable names."""
    return dataclasses.replace(trace, scene=printable_scene(trace.scene))
