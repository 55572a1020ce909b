"""One episode as a recording for the Rerun viewer (https://rerun.io), with the layout of the viewer in it.

What a step of the log holds is at the step's number on the timeline `step`; poses and rays are at the step that begins
there, and those after the last step at the number after it. The timeline `time` is simulated time since the episode
began. Shapes: `T` steps, `M` cars, `R` rays, `N` lines.
"""

import importlib.util
import os
import subprocess
import sys
import uuid
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carrl.errors import CarrlError
from carrl.files import write_whole
from carrl.log.scene import Floats
from carrl.log.trace import EpisodeTrace
from carrl.render import MOST_SEEN
from carrl.render.car import placed
from carrl.render.colours import DARK, ERROR, INFO, WARNING, Colour, rgb
from carrl.render.episode import EpisodeScene, Lines, Series, States

try:
    import rerun as rr
    import rerun.blueprint as rrb
except ImportError as error:
    raise CarrlError(
        "recordings for Rerun need rerun-sdk, which is not installed; pip install 'carrl[export]'"
    ) from error

VIEWER = "import sys; from rerun_cli.__main__ import main; sys.exit(main())"
"""Not `python -m rerun_cli`, which in Rerun 0.41 always succeeds, whatever becomes of the viewer."""
LISTEN = ("--bind", "127.0.0.1", "--port", "auto")
"""Unless told otherwise, Rerun listens on all interfaces, and hands the recording to a viewer that is already open."""
MAP_FRAME, CLOSE_UP_FRAME = "map", "follow/close_up"
"""From these entities the world looks right: Rerun's 2D views have y downwards, and here it is turned up."""
SMALLEST_CAR = 4.5
"""Radius of the dot that marks the car on the map of a long circuit, points."""
LARGE = 200.0
"""Extent of a circuit from which on its walls are drawn thin, m."""
MARGIN = 0.05
"""Free space around the track, as a share of its size."""
CLOSE_UP = 1.2
"""How far the close-up reaches from the car, as a multiple of the sensor's range."""
LEVELS = {
    "info": (rr.TextLogLevel.INFO, INFO),
    "warning": (rr.TextLogLevel.WARN, WARNING),
    "error": (rr.TextLogLevel.ERROR, ERROR),
}
"""What Rerun calls each level of an event, and its colour."""
MOST_IN_LEGEND = 6
"""Of a plot with more lines the legend would cover them."""


def write_recording(path: str | Path, trace: EpisodeTrace, title: str) -> None:
    """Writes an .rrd file, whole or not at all; the same episode is the same recording to the viewer.

    Args:
        path: where to write it; the folder must exist.
        trace: the episode.
        title: what the viewer calls it.

    Raises:
        CarrlError: it cannot be written there.
    """
    scene = EpisodeScene(trace)
    recording = rr.RecordingStream("carrl", recording_id=uuid.UUID(bytes=scene.digest).hex, send_properties=False)
    memory = recording.memory_recording()
    recording.send_recording_name(title)
    facts: dict[str, Any] = {**scene.facts, "begins_at_s": float(trace.times[0])}
    recording.send_property("episode", rr.AnyValues(**facts))
    recording.send_blueprint(_blueprint(scene))
    _Episode(recording, scene).send()
    content = memory.drain_as_bytes()
    recording.disconnect()
    write_whole(path, content)


def open_recording(path: str | Path) -> None:
    """Shows a recording in the Rerun viewer, which listens on this computer only, until its window is closed.

    Raises:
        CarrlError: the viewer fails, for want of a screen perhaps, or is not installed.
    """
    if importlib.util.find_spec("rerun_cli") is None:
        raise CarrlError("Rerun's viewer is not installed; pip install 'carrl[export]'")
    command = [sys.executable, "-c", VIEWER, os.path.abspath(path), *LISTEN]
    status = subprocess.run(command, env={"RUST_LOG": "error", **os.environ}, check=False).returncode
    if status != 0:
        raise CarrlError(f"the Rerun viewer failed, status {status}; open '{path}' on a computer with a screen")


class _Episode:
    """Sends an episode to a recording: columns with a row for each of some steps, and what holds for all of them."""

    def __init__(self, recording: rr.RecordingStream, scene: EpisodeScene) -> None:
        self._recording, self._scene, self._trace = recording, scene, scene.trace

    def send(self) -> None:
        """Sends all of it."""
        for lines in self._scene.track:
            self._send_lines(lines)
        self._send_frames()
        self._send_trail()
        self._send_cars("car", self._trace.poses[:, None], DARK.car, draw_order=30)
        if self._trace.others.size:
            self._send_cars("other_cars", self._trace.others, DARK.other_car, draw_order=25)
        self._send_rays()
        for states in self._scene.states:
            self._send_states(states)
        for series in self._scene.series:
            self._send_series(series)
        self._send_events()

    def _at(self, path: str, rows: Sequence[int] | NDArray[np.int64], columns: Iterable[rr.ComponentColumn]) -> None:
        """Adds columns to an entity; their n-th row is of the n-th of these rows of the trace, 0 .. T."""
        steps = self._scene.steps[rows]
        times = np.round(steps * self._trace.scene.time_step * 1e9).astype("timedelta64[ns]")
        index = [rr.TimeColumn("step", sequence=steps), rr.TimeColumn("time", duration=times)]
        self._recording.send_columns(path, index, columns)

    def _always(self, path: str, archetype: rr.AsComponents) -> None:
        self._recording.log(path, archetype, static=True)

    def _send_lines(self, lines: Lines) -> None:
        left, bottom, right, top = self._trace.track.bounds
        thin = max(right - left, top - bottom) >= LARGE  # or else the map shows no road between its walls
        radii = _points((0.25 if thin else 0.5) * lines.weight)
        strips = lines.ends.astype(np.float32)
        self._always(f"track/{lines.name}", rr.LineStrips2D(strips, colors=rgb(lines.colour), radii=radii))

    def _send_frames(self) -> None:
        """A frame that stands still, and one that goes with the car without turning."""
        positions = np.pad(self._trace.poses[:, :2], ((0, 0), (0, 1)))
        self._at("follow", range(len(positions)), rr.Transform3D.columns(translation=positions))
        for frame in (MAP_FRAME, CLOSE_UP_FRAME):
            self._always(frame, rr.Transform3D.from_fields(scale=[1, -1, 1]))

    def _send_trail(self) -> None:
        """The way of each step, once it has been driven."""
        rows, ways, colours = self._scene.trail
        shades = np.array([rgb(colour) for colour in colours], dtype=np.uint8).reshape(-1, 3)
        self._at("car/trail", rows + 1, rr.LineStrips2D.columns(strips=ways.astype(np.float32), colors=shades))
        self._always("car/trail", rr.LineStrips2D.from_fields(radii=_points(1.6), draw_order=21))

    def _send_cars(self, path: str, poses: Floats, colour: str, draw_order: float) -> None:
        """Cars at poses [T + 1, M, 3]: discs or rectangles, a dot that never gets too small to see, and headings."""
        scene, (rows, cars), colours = self._trace.scene, poses.shape[:2], [rgb(colour)]
        middles, headings, radius = poses[..., :2].reshape(-1, 2), poses[..., 2].ravel(), scene.body_radius
        if scene.body_size is not None:
            corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1], [1, 1]]) * np.array(scene.body_size) / 2
            outlines = np.stack([placed(corners, pose) for pose in poses.reshape(-1, 3)]).astype(np.float32)
            strips = rr.LineStrips2D.columns(strips=outlines).partition([cars] * rows)
            self._at(f"{path}/outline", range(rows), strips)
            style = rr.LineStrips2D.from_fields(radii=_points(1.5), colors=colours, draw_order=draw_order + 2)
            self._always(f"{path}/outline", style)
            radius = 0.25 * scene.body_size[1]
        noses = 4 * radius * np.stack([np.cos(headings), np.sin(headings)], axis=1)
        discs = rr.Points2D.columns(positions=np.repeat(middles, 2, axis=0)).partition([2 * cars] * rows)
        arrows = rr.Arrows2D.columns(origins=middles, vectors=noses).partition([cars] * rows)
        self._at(f"{path}/body", range(rows), [*discs, *arrows])
        radii = [radius, _points(SMALLEST_CAR)] * cars
        self._always(f"{path}/body", rr.Points2D.from_fields(radii=radii, colors=colours, draw_order=draw_order + 1))
        noses_style = rr.Arrows2D.from_fields(radii=_points(1.6), colors=colours, draw_order=draw_order)
        self._always(f"{path}/body", noses_style)

    def _send_rays(self) -> None:
        """The rays, with dots where they meet a wall."""
        ends, hits, colours = self._trace.ray_ends(), self._scene.hits, [rgb(DARK.ray)]
        begins = np.broadcast_to(self._trace.origins[:, None], ends.shape)
        rays = np.stack([begins, ends], axis=2).reshape(-1, 2, 2).astype(np.float32)
        lines = rr.LineStrips2D.columns(strips=rays).partition([ends.shape[1]] * len(ends))
        dots = rr.Points2D.columns(positions=ends[hits]).partition(hits.sum(axis=1))
        self._at("car/rays", range(len(ends)), [*lines, *dots])
        self._always("car/rays", rr.LineStrips2D.from_fields(radii=_points(0.7), colors=colours, draw_order=22))
        self._always("car/rays", rr.Points2D.from_fields(radii=_points(2.8), colors=colours, draw_order=23))

    def _send_states(self, states: States) -> None:
        """The states where they change, and the colours of all that there are."""
        changes = np.flatnonzero(np.append(True, np.diff(states.values) != 0))
        names = [states.names[value] for value in states.values[changes]]
        self._at(states.name, changes, rr.StateChange.columns(state=names))
        self._always(states.name, rr.StateConfiguration(values=list(states.names), colors=_shades(states.colours)))

    def _send_series(self, series: Series) -> None:
        """A line for each entry."""
        widths = [1.5 if len(series.entries) <= MOST_IN_LEGEND else 1.0] * len(series.entries)
        style = rr.SeriesLines(names=list(series.entries), colors=_shades(series.colours), widths=widths)
        self._at(series.name, range(len(series.values)), rr.Scalars.columns(scalars=series.values))
        self._always(series.name, style)

    def _send_events(self) -> None:
        events = self._scene.events
        columns = rr.TextLog.columns(
            text=[event.text for event in events],
            level=[LEVELS[event.level][0] for event in events],
            color=_shades([LEVELS[event.level][1] for event in events]),
        )
        self._at("events", [event.row for event in events], columns)


def _blueprint(scene: EpisodeScene) -> rrb.Blueprint:
    """The viewer's layout: the map large at the left, plots at the right; it plays in real time from the start."""
    events = rrb.TextLogView(origin="/events", name="Events", columns=rrb.TextLogColumns(text_log_columns=["body"]))
    left = rrb.Vertical(_map(scene), rrb.Horizontal(_close_up(scene), events, column_shares=[5, 6]), row_shares=[5, 3])
    axis = rrb.TimeAxis(link="LinkToGlobal")  # zooming into one zooms into all
    origins = [f"/{states.name}" for states in scene.states]
    plots: list[rrb.View] = []
    shares: list[float] = []
    if origins:
        name = "Action, and how it was chosen" if "/action" in origins else "How the action was chosen"
        plots.append(rrb.StateTimelineView(contents=origins, name=name, time_view=axis))
        shares.append(1.7)
    for series in scene.series:
        legend = rrb.PlotLegend(visible=1 < len(series.entries) <= MOST_IN_LEGEND)
        name = series.title[:1].upper() + series.title[1:]
        plots.append(rrb.TimeSeriesView(origin=f"/{series.name}", name=name, axis_x=axis, plot_legend=legend))
        shares.append(3 if len(series.entries) > 1 else 2.2 if series.name == "speed" else 1.5)
    return rrb.Blueprint(
        rrb.Horizontal(left, rrb.Vertical(*plots, row_shares=shares), column_shares=[5, 4]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline="time", play_state="playing"),
        auto_layout=False,
        auto_views=False,
    )


def _map(scene: EpisodeScene) -> rrb.Spatial2DView:
    left, bottom, right, top = scene.trace.track.bounds
    margin = MARGIN * max(right - left, top - bottom)
    bounds = rrb.VisualBounds2D(x_range=[left - margin, right + margin], y_range=[-top - margin, -bottom + margin])
    return _spatial_view(MAP_FRAME, f"Track {scene.trace.track.name}", bounds)


def _close_up(scene: EpisodeScene) -> rrb.Spatial2DView:
    reach = CLOSE_UP * min(scene.trace.scene.sensor_range, MOST_SEEN)
    bounds = rrb.VisualBounds2D(x_range=[-reach, reach], y_range=[-reach, reach])
    return _spatial_view(CLOSE_UP_FRAME, "Close-up", bounds)


def _spatial_view(frame: str, name: str, bounds: rrb.VisualBounds2D) -> rrb.Spatial2DView:
    """A map seen from a frame; of the trail it shows all up to now."""
    first, now = rr.TimeRangeBoundary.infinite(), rr.TimeRangeBoundary.cursor_relative()
    ranges = [rr.VisibleTimeRange(timeline, start=first, end=now) for timeline in ("step", "time")]
    return rrb.Spatial2DView(
        origin=frame,
        contents=["/track/**", "/car/**", "/other_cars/**"],
        name=name,
        background=list(rgb(DARK.ground)),
        visual_bounds=bounds,
        overrides={"/car/trail": rrb.VisibleTimeRanges(ranges)},
    )


def _shades(colours: Sequence[str]) -> list[Colour]:
    return [rgb(colour) for colour in colours]


def _points(width: float) -> float:
    """A radius that stays the same on the screen when one zooms; Rerun takes negative ones so."""
    return -width
