"""A layout for Foxglove and Lichtblick that fits a result: scene, plots, log."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

import polars as pl

from istc_replay.export.colours import vehicle_colours
from istc_replay.export.foxglove import MAP
from istc_replay.export.foxglove_log import TOPIC as LOG_TOPIC
from istc_replay.export.placing import topic_name

#: Vehicles with lines of their own; a plot of more is a tangle.
_PLOTTED = 24
_PLOTS = (
    ("speed", "speed [m/s]", "speed_mps"),
    ("acceleration", "acceleration [m/s²]", "acceleration_mps2"),
    ("steering", "steering [rad]", "steering_rad"),
)
#: The level from which the log panel shows lines, as Foxglove counts them: information.
_INFORMATION = 2
_PLAIN = re.compile("[A-Za-z0-9_/]+")


def foxglove_layout(states: Iterable[pl.DataFrame]) -> dict[str, Any]:
    """Lay out result.mcap for import in Foxglove or Lichtblick.

    The scene from above at an angle, with paths and transforms; below it the speed, acceleration and
    steering of the planned (solid) and of the recorded vehicles; beside it the log and the solves.

    Parameters
    ----------
    states : iterable of DataFrame
        The result's states, in one table or in several.
    """
    extents = pl.concat([_extents(part) for part in states])
    planned, recorded = (
        sorted(extents.filter(pl.col("source") == source)["vehicle_id"].unique(), key=_natural)
        for source in ("planned", "recorded")
    )
    colours = {
        vehicle: f"#{red:02x}{green:02x}{blue:02x}"
        for vehicle, (red, green, blue) in vehicle_colours({*planned, *recorded}).items()
    }
    plots = {
        f"Plot!{panel}": _plot(title, field, planned, recorded, colours) for panel, title, field in _PLOTS
    }
    return {
        "configById": {
            "3D!scene": _scene(extents, planned, colours),
            **plots,
            "Tab!plots": {
                "activeTabIdx": 0,
                "tabs": [{"title": panel, "layout": f"Plot!{panel}"} for panel, _, _ in _PLOTS],
            },
            "RosOut!log": {"topicToRender": LOG_TOPIC, "minLogLevel": _INFORMATION, "searchTerms": []},
            "RawMessages!solves": {"topicPath": "/istc/solves", "diffEnabled": False},
        },
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1.0},
        "layout": {
            "direction": "row",
            "splitPercentage": 68,
            "first": {
                "direction": "column",
                "splitPercentage": 65,
                "first": "3D!scene",
                "second": "Tab!plots",
            },
            "second": {
                "direction": "column",
                "splitPercentage": 55,
                "first": "RosOut!log",
                "second": "RawMessages!solves",
            },
        },
    }


def _natural(vehicle_id: str) -> tuple[int, str]:
    return len(vehicle_id), vehicle_id


def _quoted(topic: str) -> str:
    """A topic in a message path: in quotes where it holds more than word characters."""
    return topic if _PLAIN.fullmatch(topic) else f'"{topic}"'


def _extents(states: pl.DataFrame) -> pl.DataFrame:
    """The least and largest places of each vehicle of each source; null where there is none."""
    placed = pl.when(pl.col("x_m").is_finite() & pl.col("y_m").is_finite()).then(pl.col("x_m", "y_m"))
    return states.group_by("source", "vehicle_id").agg(
        placed.min().name.suffix("_least"), placed.max().name.suffix("_most")
    )


def _scene(extents: pl.DataFrame, planned: Iterable[str], colours: dict[str, str]) -> dict[str, Any]:
    driven = extents.filter(pl.col("source") != "guidance")
    low = driven.select(pl.col("x_m_least", "y_m_least").min()).row(0)
    high = driven.select(pl.col("x_m_most", "y_m_most").max()).row(0)
    sides = [0.0 if a is None or b is None else b - a for a, b in zip(low, high, strict=True)]
    middle = [
        0.0 if a is None or b is None else round((a + b) / 2.0, 3) for a, b in zip(low, high, strict=True)
    ]
    paths = {
        f"/istc/path/{topic_name(vehicle)}": {
            "visible": True,
            "type": "line",
            "lineWidth": 0.3,
            "gradient": [f"{colours[vehicle]}ff", f"{colours[vehicle]}ff"],
        }
        for vehicle in planned
    }
    return {
        "cameraState": {
            "perspective": True,
            "distance": round(1.2 * max(*sides, 20.0), 1),
            "phi": 35,
            "thetaOffset": 0,
            "targetOffset": [*middle, 0],
            "target": [0, 0, 0],
            "targetOrientation": [0, 0, 0, 1],
            "fovy": 45,
            "near": 0.5,
            "far": 50_000,
        },
        "followMode": "follow-none",
        "followTf": MAP,
        "scene": {"enableStats": False, "transforms": {"showLabel": False, "axisScale": 0.6}},
        "transforms": {},
        "topics": {"/istc/scene": {"visible": True}, **paths},
        "layers": {
            "grid": {
                "layerId": "foxglove.Grid",
                "instanceId": "grid",
                "label": "Grid",
                "visible": True,
                "frameId": MAP,
                "size": round(2.0 * max(*sides, 20.0), -1),
                "divisions": int(round(2.0 * max(*sides, 20.0), -1) / 10.0),
                "position": [*middle, 0],
                "color": "#80808040",
            }
        },
    }


def _plot(
    title: str, field: str, planned: list[str], recorded: list[str], colours: dict[str, str]
) -> dict[str, Any]:
    series = [(vehicle, "planned") for vehicle in planned[:_PLOTTED]]
    series += [(vehicle, "recorded") for vehicle in recorded[:_PLOTTED]]
    return {
        "title": title,
        "paths": [
            {
                "value": f"{_quoted(f'/istc/{source}/{topic_name(vehicle)}')}.{field}",
                "label": f"{vehicle} {source}",
                "enabled": source == "planned" or not planned,
                "timestampMethod": "receiveTime",
                "color": colours[vehicle],
                "lineSize": 2.0 if source == "planned" else 1.0,
            }
            for vehicle, source in series
        ],
        "xAxisVal": "timestamp",
        "isSynced": True,
        "showLegend": True,
        "legendDisplay": "left",
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "showPlotValuesInLegend": False,
        "sidebarDimension": 200,
    }
