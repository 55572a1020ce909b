"""What a log holds, made harmless for a terminal."""

import dataclasses

from carrl.log.scene import Scene
from carrl.log.trace import EpisodeTrace
from carrl.printable import printable

__all__ = ["printable", "printable_scene", "printable_trace"]


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
