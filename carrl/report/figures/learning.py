"""Learning curves of groups, and the share of their runs that reach a lap or a score."""

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator, PercentFormatter, StrMethodFormatter

from carrl.render.colours import FAINT, INK
from carrl.render.figure import new_figure, plain_axes, save_figure
from carrl.report.curves import Curve, lap_profiles, return_curves, score_profiles
from carrl.report.figures.series import Look, draw_curves, legend_rows, looks, name_groups
from carrl.report.groups import Group
from carrl.report.measures import FINAL_RETURN, LAP_REWARD


def draw_returns(path: Path, groups: Sequence[Group]) -> bool:
    """Writes a PNG of every group's return against frames; False, and no file, where no run has episodes."""
    curves = return_curves(groups)
    if not curves:
        return False
    styles = looks(groups)
    figure = new_figure(height=3.6 + 0.17 * legend_rows(curves))
    axes = figure.subplots()
    plain_axes(axes)
    draw_curves(axes, curves, styles)
    axes.set_xlim(0, max(curve.points[-1] for curve in curves))
    axes.yaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
    _count_frames(axes)
    _name_axes(axes, "frames (env steps)", "return, mean of the last 20 episodes")
    _warn_of_scales(axes, groups)
    axes.set_title("interquartile mean, 95 % band", fontsize=7.5, color=FAINT, loc="right")
    name_groups(figure, curves, styles)
    save_figure(figure, path)
    return True


def draw_profiles(path: Path, groups: Sequence[Group]) -> bool:
    """Writes a PNG of performance profiles: who has lapped by when, and who ends above which return.

    Runs that learnt from logs have neither; of them the reward of the best drive is shown. False, and no file, if no
    run counts.
    """
    laps, returns = lap_profiles(groups), score_profiles(groups, FINAL_RETURN)
    rewards = [] if returns else score_profiles(groups, LAP_REWARD)
    panels = [curves for curves in (laps, returns, rewards) if curves]
    if not panels:
        return False
    styles = looks(groups)
    figure = new_figure(height=3.0 + 0.17 * legend_rows(panels[0]))
    for axes, curves in zip(figure.subplots(1, len(panels), squeeze=False).flat, panels, strict=True):
        _draw_profile(axes, curves, styles)
        if curves is laps:
            axes.set_xlim(left=0)
            _count_frames(axes, ticks=5)
            _name_axes(axes, "frames (env steps)", "share of runs that have lapped")
            axes.set_title("95 % bands", fontsize=7.5, color=FAINT, loc="right")
        else:
            what = "final return, mean of 20 episodes" if curves is returns else "reward of the best drive"
            axes.xaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
            axes.xaxis.set_major_locator(MaxNLocator(nbins=5))
            _name_axes(axes, f"τ: {what}", "share of runs above τ")
            _warn_of_scales(axes, groups)
    name_groups(figure, max(panels, key=len), styles)
    save_figure(figure, path)
    return True


def _draw_profile(axes: Axes, curves: Sequence[Curve], styles: dict[str, Look]) -> None:
    plain_axes(axes)
    draw_curves(axes, curves, styles, steps=True)
    axes.set_xlim(min(curve.points[0] for curve in curves), max(curve.points[-1] for curve in curves))
    axes.set_ylim(-0.02, 1.04)
    axes.yaxis.set_major_formatter(PercentFormatter(1, symbol=" %"))


def _count_frames(axes: Axes, ticks: int = 6) -> None:
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
    axes.xaxis.set_major_locator(MaxNLocator(nbins=ticks, steps=[1, 2, 5, 10]))


def _warn_of_scales(axes: Axes, groups: Sequence[Group]) -> None:
    if not FINAL_RETURN.is_on_one_scale(run for group in groups for run in group.counted):
        axes.set_title("rewards or tracks differ, and so do the scales", fontsize=7.5, color=FAINT, loc="left")


def _name_axes(axes: Axes, horizontal: str, vertical: str) -> None:
    axes.set_xlabel(horizontal, color=INK, fontsize=9)
    axes.set_ylabel(vertical, color=INK, fontsize=9)
