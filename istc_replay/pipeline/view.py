"""Views of a finished result: where it opens, whom it shows, and the ways to look at it."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import polars as pl

from istc_replay.config import ViewConfig, parse_config
from istc_replay.errors import UsageError
from istc_replay.export.rerun.view import Opening, write_view
from istc_replay.export.rerun.viewer import send_view, start_viewer
from istc_replay.export.web_bundle import write_bundle
from istc_replay.export.web_server import folder_server
from istc_replay.pipeline.reading import Reading, read_in_parts
from istc_replay.units import NS_PER_S

if TYPE_CHECKING:
    from http.server import ThreadingHTTPServer

    from istc_replay.datatypes import Result

_NAMED = 8


@dataclass(frozen=True, slots=True)
class View:
    """A result to be looked at: `opening` says how it opens, `instant_ns` where, from the first window on."""

    reading: Reading
    folder: Path
    config: ViewConfig
    opening: Opening
    instant_ns: int | None

    def save(self, path: Path) -> None:
        """Write it as an .rrd file."""
        write_view(self.reading.result, self.config, path, self.opening, self.reading.parts)

    def bundle(self, folder: Path) -> None:
        """Write it as a folder for any static web server."""
        report = self.folder / "report.html"
        result, parts = self.reading.result, self.reading.parts
        write_bundle(result, self.config, folder, self.opening, self.instant_ns, report, parts)

    def show(self, url: str | None = None) -> None:
        """Show it in the viewer at an address, or in a new one."""
        result, parts = self.reading.result, self.reading.parts
        send_view(result, self.config, url or start_viewer(), self.opening, self.instant_ns, parts)

    @contextmanager
    def served(self, port: int = 0) -> Iterator[ThreadingHTTPServer]:
        """Give a server on 127.0.0.1 that shows it in a browser, once it is told to serve."""
        with (
            tempfile.TemporaryDirectory(prefix="istc-view-") as folder,
            folder_server(Path(folder), port) as server,
        ):
            self.bundle(Path(folder))
            yield server


def open_view(
    source: Path, *, at: str | None = None, finding: str | None = None, focus: Sequence[str] = ()
) -> View:
    """Read a result's folder or file to look at it.

    Parameters
    ----------
    at : str, optional
        Seconds from the first window's start, or a date and time (ISO 8601).
    finding : str, optional
        The id of a finding or its beginning: opens where it is worst, and shows its vehicles.
    focus : sequence of str
        Vehicles to show in full; without `at` and `finding` it opens when the last of them comes.

    Raises
    ------
    LogError
        If there is no readable result.
    UsageError
        If the result has no such instant, finding or vehicle.
    """
    reading = read_in_parts(source)
    result = reading.result
    config = parse_config(result.config_toml, f"{source}: config.toml").view
    origin_ns, first_ns, last_ns = _times(result)
    instant_ns: int | None = None
    vehicles = tuple(dict.fromkeys(focus))
    if finding is not None:
        worst_ns, involved = _finding(result, finding)
        instant_ns, vehicles = worst_ns, vehicles or involved
    if vehicles:
        known = reading.vehicles()
        for vehicle_id in vehicles:
            if vehicle_id not in known:
                raise UsageError(f"--focus {vehicle_id}: no such vehicle; there are {_some(sorted(known))}")
        if instant_ns is None:
            instant_ns = max(origin_ns, *(known[vehicle_id] for vehicle_id in vehicles))
    if at is not None:
        instant_ns = _instant(at, origin_ns)
    if instant_ns is not None and not first_ns <= instant_ns <= last_ns:
        span = f"{(first_ns - origin_ns) / NS_PER_S:g} to {(last_ns - origin_ns) / NS_PER_S:g} s"
        raise UsageError(f"--at {at}: the result has nothing there; it holds {span}")
    return View(
        reading=reading,
        folder=source if source.is_dir() else source.parent,
        config=config,
        opening=Opening(vehicles, close_up=bool(vehicles)),
        instant_ns=None if instant_ns is None else instant_ns - origin_ns,
    )


def _times(result: Result) -> tuple[int, int, int]:
    """Where the view's time begins, and its first and last instants [ns]."""
    times = result.states["time_ns"]
    starts = [w["start_ns"] for w in result.summary["windows"]]
    ends = [w["end_ns"] for w in result.summary["windows"]]
    known = [int(t) for t in (times.min(), times.max()) if isinstance(t, int)]
    first, last = min(starts + known, default=0), max(ends + known, default=0)
    return min(starts, default=first), first, last


def _instant(at: str, origin_ns: int) -> int:
    try:
        return origin_ns + round(float(at) * NS_PER_S)
    except (ValueError, OverflowError):
        pass
    try:
        moment = datetime.fromisoformat(at)
    except ValueError:
        raise UsageError(
            f"--at {at}: is neither seconds from the first window's start, as 4.2, nor a date and time, "
            "as 2026-05-04T10:11:12Z"
        ) from None
    since = (moment if moment.tzinfo else moment.replace(tzinfo=UTC)) - datetime(1970, 1, 1, tzinfo=UTC)
    return (since.days * 86_400 + since.seconds) * NS_PER_S + since.microseconds * 1000


def _finding(result: Result, name: str) -> tuple[int, tuple[str, ...]]:
    findings = result.findings
    matching = findings.filter(pl.col("finding_id").str.starts_with(name))
    if matching.height != 1:
        known = _some(findings["finding_id"].to_list())
        what = "more than one finding begins so" if matching.height else "no such finding"
        raise UsageError(f"--finding {name}: {what}; the result has {known}")
    row = matching.row(0, named=True)
    return row["worst_ns"], tuple(row["vehicles"] or ())


def _some(names: Sequence[str]) -> str:
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return (", ".join(names[:_NAMED]) or "none") + more
