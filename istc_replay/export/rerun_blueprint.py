"""The layout of the Rerun view.

It knows no vehicle and no place: a running viewer keeps the first blueprint that it gets for an
application, so one layout serves all results. Contents are whole subtrees, and the spatial views
follow eyes that the data itself provides.
"""

from __future__ import annotations

import rerun.blueprint as rrb

_LINKED = rrb.components.LinkAxis.LinkToGlobal


def blueprint() -> rrb.Blueprint:
    """The layout: space-time, the view from above, report and events; plots and states below."""
    upper = rrb.Horizontal(
        _space_time_tabs(),
        _above_tabs(),
        rrb.Vertical(
            rrb.TextDocumentView(name="report", origin="/report", contents=["/report/**"]),
            _events(),
            row_shares=[3, 2],
        ),
        column_shares=[40, 31, 29],
    )
    lower = rrb.Horizontal(
        _plot_tabs("speed", "speed [m/s]"),
        _plot_tabs("acceleration", "accel [m/s²]"),
        _plot_tabs("clearance", "clearance [m]"),
        _state_tabs(),
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


def _space_time_tabs() -> rrb.Tabs:
    shared = ["/space_time/shared/**", "/now/square/**", "/camera/**"]
    planned = ["/space_time/planned/**", "/now/planned/box/**"]
    recorded = ["/space_time/recorded/**", "/now/recorded/box/**"]
    contents = {"both": planned + recorded, "planned": planned, "recorded": recorded}
    return rrb.Tabs(
        *(
            rrb.Spatial3DView(
                name=f"corridors x-y-t: {name}",
                origin="/",
                contents=shared + own,
                eye_controls=rrb.EyeControls3D(tracking_entity="/camera"),
                line_grid=rrb.LineGrid3D(visible=True, stroke_width=0.5),
            )
            for name, own in contents.items()
        )
    )


def _above_tabs() -> rrb.Tabs:
    shared = ["/now/shared/**", "/now/camera/**"]
    contents = {
        "both": ["/now/planned/**", "/now/recorded/**"],
        "planned": ["/now/planned/**"],
        "recorded": ["/now/recorded/**", "/now/names/**"],
    }
    return rrb.Tabs(
        *(
            rrb.Spatial3DView(
                name=f"top-down: {name}",
                origin="/now",
                contents=shared + own,
                eye_controls=rrb.EyeControls3D(tracking_entity="/now/camera"),
                line_grid=rrb.LineGrid3D(visible=False),
            )
            for name, own in contents.items()
        )
    )


def _events() -> rrb.TextLogView:
    return rrb.TextLogView(
        name="events",
        origin="/events",
        contents=["/events/**"],
        columns=rrb.TextLogColumns(timeline_columns=["scenario_time"], text_log_columns=["loglevel", "body"]),
    )


def _plot(signal: str, name: str, source: str = "") -> rrb.TimeSeriesView:
    root = f"/plots/{signal}"
    contents = [f"{root}/{source}/**", f"{root}/limit/**"] if source else [f"{root}/**"]
    return rrb.TimeSeriesView(
        name=f"{name.split()[0]}: {source}" if source else name,
        origin=root,
        contents=contents,
        axis_x=rrb.TimeAxis(link=_LINKED),
        # The least clearances are what one looks for at the bottom.
        plot_legend=rrb.PlotLegend(
            rrb.Corner2D.RightTop if signal == "clearance" else rrb.Corner2D.RightBottom
        ),
    )


def _plot_tabs(signal: str, name: str) -> rrb.Tabs:
    return rrb.Tabs(_plot(signal, name), _plot(signal, name, "planned"), _plot(signal, name, "recorded"))


def _state_tabs() -> rrb.Tabs:
    return rrb.Tabs(
        rrb.StateTimelineView(
            name="states",
            origin="/states",
            contents=["/states/**"],
            time_view=rrb.TimeAxis(link=_LINKED),
        ),
        rrb.GraphView(name="precedence", origin="/precedence", contents=["/precedence/**"]),
        _plot("steering", "steering [rad]"),
        _plot("jerk", "jerk [m/s³]"),
    )
