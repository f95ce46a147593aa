"""The layout of the Rerun view.

It knows no vehicle and no place: a running viewer keeps the first blueprint that it gets for an
application, so one layout serves all results. Contents are whole subtrees, and the spatial views
follow eyes that the data itself provides.
"""

from __future__ import annotations

from typing import Any

import rerun as rr
import rerun.blueprint as rrb

#: The tab of the view from above that follows whom one asked for.
CLOSE_UP = 3
_LINKED = rrb.components.LinkAxis.LinkToGlobal


def blueprint(*, tab: int = 0, above: int | None = None) -> rrb.Blueprint:
    """The layout: space-time, the view from above, report, events and vehicles; plots and states below.

    Parameters
    ----------
    tab : int
        Which of its tabs each stack shows at first: both, planned, recorded.
    above : int, optional
        Which tab the view from above shows at first; `CLOSE_UP` follows whom one asked for.
    """
    upper = rrb.Horizontal(
        _space_time_tabs(tab),
        _above_tabs(tab if above is None else above),
        rrb.Vertical(
            rrb.TextDocumentView(name="report", origin="/report", contents=["/report/**"]),
            rrb.Tabs(_log("events"), _log("vehicles")),
            row_shares=[3, 2],
        ),
        column_shares=[40, 31, 29],
    )
    lower = rrb.Horizontal(
        _plot_tabs("speed", "speed [m/s]", tab),
        _plot_tabs("acceleration", "accel [m/s²]", tab),
        _plot_tabs("clearance", "clearance [m]", tab),
        _state_tabs(tab),
        column_shares=[26, 26, 24, 24],
    )
    return rrb.Blueprint(
        rrb.Vertical(upper, lower, row_shares=[58, 42]),
        rrb.TimePanel(timeline="scenario_time", state="collapsed", play_state="paused", loop_mode="all"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_layout=False,
        auto_views=False,
    )


def _tabs(views: list[Any], tab: int) -> rrb.Tabs:
    return rrb.Tabs(*views, active_tab=min(tab, len(views) - 1))


def _space_time_tabs(tab: int) -> rrb.Tabs:
    shared = ["/space_time/shared/**", "/now/square/**", "/camera/**"]
    quiet = "/space_time/quiet"
    planned = ["/space_time/planned/**", "/now/planned/box/**", f"{quiet}/planned/**"]
    recorded = ["/space_time/recorded/**", "/now/recorded/box/**"]
    contents = {
        "corridors x-y-t: both": [*planned[:2], *recorded, f"{quiet}/**"],
        "planned": planned,
        "recorded": [*recorded, "/now/names/**"],
    }
    return _tabs(
        [
            rrb.Spatial3DView(
                name=name,
                origin="/",
                contents=shared + own,
                eye_controls=rrb.EyeControls3D(tracking_entity="/camera"),
                line_grid=rrb.LineGrid3D(visible=True, stroke_width=0.5),
                defaults=_names(False),
                overrides=_hidden(quiet),
            )
            for name, own in contents.items()
        ],
        tab,
    )


def _above_tabs(tab: int) -> rrb.Tabs:
    shared = ["/now/shared/**"]
    planned, recorded = ["/now/planned/**"], ["/now/recorded/**"]
    quiet = "/now/quiet"
    both = [*planned, *recorded, f"{quiet}/**"]
    tabs = {
        "top-down: both": (both, "camera", False),
        "planned": ([*planned, f"{quiet}/planned/**"], "camera", False),
        "recorded": ([*recorded, "/now/names/**", f"{quiet}/recorded/**"], "camera", False),
        "close-up": (both, "close_up", True),
        "names": (both, "camera", True),
    }
    return _tabs(
        [
            rrb.Spatial3DView(
                name=name,
                origin="/now",
                contents=[*shared, f"/now/{eye}/**", *own],
                eye_controls=rrb.EyeControls3D(tracking_entity=f"/now/{eye}"),
                line_grid=rrb.LineGrid3D(visible=False),
                defaults=_names(named),
                overrides=_hidden(quiet),
            )
            for name, (own, eye, named) in tabs.items()
        ],
        tab,
    )


def _names(shown: bool) -> list[rr.Boxes3D | rr.Points3D]:
    """Whether boxes and marks are named that do not say so themselves."""
    return [kind.from_fields(show_labels=shown) for kind in (rr.Boxes3D, rr.Points3D)]


def _hidden(root: str) -> dict[str, rrb.EntityBehavior]:
    """A subtree that shows when its eye in the view's tree is clicked."""
    return {root: rrb.EntityBehavior(visible=False)}


def _log(name: str) -> rrb.TextLogView:
    return rrb.TextLogView(
        name=name,
        origin=f"/{name}",
        contents=[f"/{name}/**"],
        columns=rrb.TextLogColumns(timeline_columns=["scenario_time"], text_log_columns=["loglevel", "body"]),
    )


def _plot(signal: str, name: str, source: str = "") -> rrb.TimeSeriesView:
    root = f"/plots/{signal}"
    quiet = f"{root}/quiet" if signal != "clearance" else None
    contents = [f"{root}/{source}/**", f"{root}/limit/**"] if source else [f"{root}/**"]
    if source and quiet:
        contents.append(f"{quiet}/{source}/**")
    return rrb.TimeSeriesView(
        name=source or name,
        origin=root,
        contents=contents,
        axis_x=rrb.TimeAxis(link=_LINKED),
        overrides=_hidden(quiet) if quiet else None,
        # The least clearances are what one looks for at the bottom.
        plot_legend=rrb.PlotLegend(
            rrb.Corner2D.RightTop if signal == "clearance" else rrb.Corner2D.RightBottom
        ),
    )


def _plot_tabs(signal: str, name: str, tab: int) -> rrb.Tabs:
    return _tabs([_plot(signal, name, source) for source in ("", "planned", "recorded")], tab)


def _state_tabs(tab: int) -> rrb.Tabs:
    views = [
        rrb.StateTimelineView(
            name="states",
            origin="/",
            contents=["/states/**", "/quiet/states/**"],
            time_view=rrb.TimeAxis(link=_LINKED),
            overrides=_hidden("/quiet/states"),
        ),
        rrb.GraphView(name="precedence", origin="/precedence", contents=["/precedence/**"]),
        _plot("steering", "steering [rad]"),
        _plot("jerk", "jerk [m/s³]"),
    ]
    return _tabs(views, tab)
