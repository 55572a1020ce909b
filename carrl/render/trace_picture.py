"""The picture of one episode of a log: the line driven on a map of its track, as `lap.png` shows a run's best drive."""

from pathlib import Path

from carrl.log.trace import EpisodeTrace
from carrl.render.lap import draw_lap


def write_picture(path: str | Path, trace: EpisodeTrace, title: str) -> None:
    """Writes a picture of an episode, a .png, .pdf or .svg, whole or not at all.

    Args:
        path: where to write it.
        trace: the episode.
        title: one line above the map.

    Raises:
        CarrlError: the name has another ending, or the file cannot be written.
    """
    scene = trace.scene
    draw_lap(
        path,
        trace.track,
        trace.poses,
        trace.ranges,
        scene.sensor_angles,
        trace.actions,
        action_names=() if trace.controls is not None else scene.action_names,
        body_radius=scene.body_radius,
        body_size=scene.body_size,
        sensor_range=scene.sensor_range,
        sensor_mount=scene.sensor_mount,
        title=title,
        collided=trace.ended == "collision",
        speeds=trace.speeds,
        others=trace.others,
    )
