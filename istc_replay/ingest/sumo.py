"""SUMO's floating car data (FCD): front bumpers, angles clockwise from north, a box by the type."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from istc_replay.datatypes import StaticScene
from istc_replay.errors import LogError
from istc_replay.ingest.foreign import (
    BadValueError,
    ForeignRecording,
    Gathered,
    above_zero,
    finite,
    nanoseconds,
    turned,
    vehicle_name,
)
from istc_replay.ingest.places import LocalFrame
from istc_replay.ingest.problems import Problems, quoted
from istc_replay.ingest.sumo_net import read_net
from istc_replay.ingest.xml_stream import Progress, head_of, read_xml

ROOT = "fcd-export"
#: Length and width of SUMO's vehicle classes [m], by its own defaults; a class not named is a car.
_CAR = (5.0, 1.8)
CLASSES = {
    "bus": (12.0, 2.5),
    "coach": (14.0, 2.6),
    "delivery": (6.5, 2.16),
    "truck": (7.1, 2.4),
    "trailer": (16.5, 2.55),
    "emergency": (6.5, 2.16),
    "motorcycle": (2.2, 0.9),
    "moped": (2.1, 0.78),
    "bicycle": (1.6, 0.65),
    "scooter": (1.2, 0.5),
    "pedestrian": (0.215, 0.478),
    "wheelchair": (1.2, 0.72),
    "tram": (22.0, 2.4),
    "rail_urban": (109.5, 3.0),
    "subway": (109.5, 3.0),
    "rail": (135.0, 2.84),
    "rail_electric": (200.0, 2.95),
    "rail_fast": (200.0, 2.95),
    "container": (6.096, 2.438),
}
_ROLES = {"bicycle": "bicycle", "scooter": "bicycle", "pedestrian": "pedestrian", "wheelchair": "pedestrian"}
#: Types that every SUMO has, and their classes.
_BUILT_IN = {
    "DEFAULT_VEHTYPE": "passenger",
    "DEFAULT_TAXITYPE": "taxi",
    "DEFAULT_BIKETYPE": "bicycle",
    "DEFAULT_PEDTYPE": "pedestrian",
    "DEFAULT_RAILTYPE": "rail",
    "DEFAULT_CONTAINERTYPE": "container",
}
_KINDS = ("vehicle", "person", "container")
#: Coordinates on the Earth stay within these; SUMO's networks begin at 0 and soon leave them.
_GEO_NOTE = "fcd-output.geo"

Box = tuple[float, float, str]


class _Types:
    """The vTypes of SUMO's route and additional files: length, width and role by id."""

    def __init__(self) -> None:
        self.boxes: dict[str, Box] = {name: _box(kind) for name, kind in _BUILT_IN.items()}

    def start(self, path: tuple[str, ...], attributes: dict[str, str], line: int) -> None:
        if path[-1] != "vType":
            return
        try:
            length, width, role = _box(attributes.get("vClass", "passenger"))
            if "length" in attributes:
                length = above_zero(attributes["length"], "length")
            if "width" in attributes:
                width = above_zero(attributes["width"], "width")
            self.boxes[attributes.get("id", "")] = (length, width, role)
        except BadValueError as error:
            raise LogError(f"line {line}: {error}") from None

    def end(self, _path: tuple[str, ...], _text: str, _line: int) -> None:
        """Nothing is told by an element's end."""


def _box(kind: str) -> Box:
    return (*CLASSES.get(kind, _CAR), _ROLES.get(kind, "vehicle"))


class _Fcd:
    """The states of an FCD file."""

    def __init__(self, types: dict[str, Box], geo: bool, problems: Problems) -> None:
        self.states = Gathered(problems)
        self._types, self._problems = types, problems
        self._places = LocalFrame(problems) if geo else None
        self._time_ns: int | None = None

    def start(self, path: tuple[str, ...], attributes: dict[str, str], line: int) -> None:
        if path[-1] == "timestep":
            self._step(attributes, line)
        elif path[-1] in _KINDS and self._time_ns is not None:
            try:
                self._state(path[-1], attributes, self._time_ns)
            except BadValueError as error:
                who = quoted(attributes.get("id", ""), 40)
                self._problems.lose("bad_value", f"line {line}: {path[-1]} {who} is left out: {error}")

    def end(self, path: tuple[str, ...], _text: str, _line: int) -> None:
        if path[-1] == "timestep":
            self._time_ns = None

    def _step(self, attributes: dict[str, str], line: int) -> None:
        try:
            self._time_ns = nanoseconds(attributes.get("time", ""), "time")
        except BadValueError as error:
            self._problems.lose("bad_value", f"line {line}: a time step is left out: {error}")

    def _state(self, kind: str, told: dict[str, str], time_ns: int) -> None:
        vehicle = vehicle_name(told.get("id", ""))
        x, y = finite(told.get("x", ""), "x"), finite(told.get("y", ""), "y")
        if self._places is not None:
            east, north = self._places.metres(np.array([y]), np.array([x]), np.ones(1, np.bool_))
            x, y = float(east[0]), float(north[0])
        # Clockwise from north to counter-clockwise from east.
        heading = turned(math.pi / 2.0 - math.radians(finite(told.get("angle", ""), "angle")))
        length, width, role = self._size(kind, told.get("type", ""))
        # A front bumper's middle is half a length before the centre.
        x, y = x - length / 2.0 * math.cos(heading), y - length / 2.0 * math.sin(heading)
        numbers: dict[str, float | None] = {
            "x_m": x,
            "y_m": y,
            "heading_rad": heading,
            "length_m": length,
            "width_m": width,
        }
        for name, target in (("speed", "speed_mps"), ("acceleration", "acceleration_mps2")):
            if name in told:
                numbers[target] = finite(told[name], name)
        self.states.add(time_ns, vehicle, role, numbers)

    def _size(self, kind: str, type_: str) -> Box:
        # A type of a distribution is named type@distribution or has a number appended.
        found = self._types.get(type_) or self._types.get(type_.partition("@")[0])
        if found is not None:
            return found
        assumed = _box({"person": "pedestrian", "container": "container"}.get(kind, "passenger"))
        detail = (
            f"the size of type {quoted(type_, 40)} is not known: {assumed[0]} x {assumed[1]} m is taken; "
            "--types can name the file that declares it"
        )
        self._problems.add("size_assumed", detail, kind=type_)
        return assumed


def read_fcd(path: Path, types: list[Path], progress: Progress, net: Path | None = None) -> ForeignRecording:
    """Read an FCD file, plain or gzip.

    Parameters
    ----------
    path : Path
        What `sumo --fcd-output` wrote.
    types : list of Path
        SUMO files that declare the vTypes: their lengths move front bumpers to box centres.
    progress : callable
        Told bytes read and bytes in all.
    net : Path, optional
        The network that was driven on: its lanes are those of the scene.

    Raises
    ------
    LogError
        If a file is not XML, is above a limit, or holds no state, or if positions in degrees are to fit
        a network.
    """
    declared = _Types()
    for file in types:
        try:
            cut = read_xml(file, declared, lambda _done, _total: None)
        except LogError as error:
            raise LogError(str(error) if str(error).startswith(str(file)) else f"{file}: {error}") from None
        if cut:
            raise LogError(f"{file}: {cut}")
    problems = Problems()
    geo = _is_geo(path)
    if net is not None and geo:
        raise LogError(
            f"{path}: its positions are degrees, those of {net} are not; write it without {_GEO_NOTE}"
        )
    scene = StaticScene() if net is None else read_net(net, problems)
    handler = _Fcd(declared.boxes, geo, problems)
    cut = read_xml(path, handler, progress)
    if cut:
        problems.lose("truncated", f"{cut}; what stands before it is read")
    if not len(handler.states):
        why = f": {problems.first_loss}" if problems.first_loss else "; give what `sumo --fcd-output` wrote"
        raise LogError(f"{path}: holds no vehicle's state{why}")
    return ForeignRecording(
        "SUMO FCD",
        handler.states.table(),
        scene,
        problems.found(),
        not problems.lost,
        ("front bumpers moved to box centres, angles turned to counter-clockwise from east",),
    )


def _is_geo(path: Path) -> bool:
    """Tell whether the configuration that SUMO notes at the head says that positions are degrees."""
    head = head_of(path)[1]
    return f'{_GEO_NOTE} value="true"' in head or f'{_GEO_NOTE} value="1"' in head
