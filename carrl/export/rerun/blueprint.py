"""How the Rerun viewer lays out an episode: the map large at the left, plots at the right, playing from the start."""

import rerun as rr
import rerun.blueprint as rrb

from carrl.export.rerun.drawing import CLOSE_UP_FRAME, MAP_FRAME
from carrl.log.trace import EpisodeTrace
from carrl.render.viewer_palette import GROUND

RAY_COLOURS = "Sensor rays, m: left red, ahead green, right blue"
MARGIN = 0.05
"""Free space around the track, as a share of its size."""
CLOSE_UP = 1.2
"""How far the close-up reaches from the car, as a multiple of the sensor's range."""


def episode_blueprint(trace: EpisodeTrace) -> rrb.Blueprint:
    """The viewer's layout; it plays in real time, and everything else can be unfolded."""
    left = rrb.Vertical(
        _map(trace), rrb.Horizontal(_close_up(trace), _events(), column_shares=[5, 6]), row_shares=[5, 3]
    )
    right = rrb.Vertical(*_plots(), row_shares=[1.7, 3, 3, 3, 1.5])
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[5, 4]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline="time", play_state="playing"),
        auto_layout=False,
        auto_views=False,
    )


def _map(trace: EpisodeTrace) -> rrb.Spatial2DView:
    left, bottom, right, top = trace.track.bounds
    margin = MARGIN * max(right - left, top - bottom)
    bounds = rrb.VisualBounds2D(x_range=[left - margin, right + margin], y_range=[-top - margin, -bottom + margin])
    return _spatial_view(MAP_FRAME, f"Track {trace.track.name}", bounds)


def _close_up(trace: EpisodeTrace) -> rrb.Spatial2DView:
    reach = CLOSE_UP * trace.scene.sensor_range
    return _spatial_view(
        CLOSE_UP_FRAME, "Close-up", rrb.VisualBounds2D(x_range=[-reach, reach], y_range=[-reach, reach])
    )


def _spatial_view(frame: str, name: str, bounds: rrb.VisualBounds2D) -> rrb.Spatial2DView:
    """A map seen from a frame; of the trail it shows all up to now."""
    return rrb.Spatial2DView(
        origin=frame,
        contents=["/track/**", "/car/**"],
        name=name,
        background=list(GROUND),
        visual_bounds=bounds,
        overrides={"/car/trail": rrb.VisibleTimeRanges([_until_now("step"), _until_now("time")])},
    )


def _until_now(timeline: str) -> rr.VisibleTimeRange:
    now = rr.TimeRangeBoundary.cursor_relative()
    return rr.VisibleTimeRange(timeline, start=rr.TimeRangeBoundary.infinite(), end=now)


def _events() -> rrb.TextLogView:
    columns = rrb.TextLogColumns(text_log_columns=["body"])
    return rrb.TextLogView(origin="/events", name="Events", columns=columns)


def _plots() -> list[rrb.View]:
    """What is drawn over time; zooming into one zooms into all."""
    axis = rrb.TimeAxis(link="LinkToGlobal")
    share = rrb.ScalarAxis(range=(0, 1), zoom_lock=True)
    hidden = rrb.PlotLegend(visible=False)
    return [
        rrb.StateTimelineView(contents=["/action", "/choice"], name="Action, and how it was chosen", time_view=axis),
        rrb.TimeSeriesView(origin="/q_values", name="Q-values", axis_x=axis),
        rrb.TimeSeriesView(origin="/reward", name="Reward, its terms, and the return so far", axis_x=axis),
        rrb.TimeSeriesView(origin="/ranges", name=RAY_COLOURS, axis_x=axis, plot_legend=hidden),
        rrb.TimeSeriesView(origin="/epsilon", name="Epsilon", axis_x=axis, axis_y=share, plot_legend=hidden),
    ]
