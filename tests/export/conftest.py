"""Fixtures of the outputs' tests: the view in a file and its rows, a hostile result, a browser."""

from __future__ import annotations

import shutil
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from istc_replay.config import ViewConfig
from istc_replay.datatypes import Result
from istc_replay.export import report
from istc_replay.export.report import report_html
from istc_replay.export.report.markup import Html

from ..support.results import renamed

Rows = list[dict[str, Any]]

NASTY = {
    "car 1": "<script>alert(1)</script>",
    "car 2": "x\" onload='alert(2)' \u202e\u200f\n</svg><img src=//evil.example/x>",
    "car 3": "&lt;b&gt;]]>-->" + "X" * 10_000,
}


@pytest.fixture
def strict_rerun() -> Iterator[None]:
    """Let Rerun raise where it would only warn."""
    import rerun

    rerun.set_strict_mode(True)
    yield
    rerun.set_strict_mode(False)


@pytest.fixture(scope="session")
def rows_by_entity() -> Callable[[Any], dict[str, Rows]]:
    """Give all rows of chunks by entity, times as int nanoseconds; static rows have no times."""

    def rows(chunks: Any) -> dict[str, Rows]:
        found: dict[str, Rows] = defaultdict(list)
        for chunk in chunks:
            table = pl.from_arrow(chunk.to_record_batch())
            assert isinstance(table, pl.DataFrame)
            times = [name for name in ("time", "scenario_time") if name in table.columns]
            found[chunk.entity_path] += table.with_columns(pl.col(times).cast(pl.Int64)).to_dicts()
        return dict(found)

    return rows


@pytest.fixture(scope="session")
def rrd(synthetic_result: Result, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The view of `synthetic_result` in a file."""
    from istc_replay.export.rerun.view import write_view

    path = tmp_path_factory.mktemp("view") / "view.rrd"
    write_view(synthetic_result, ViewConfig(metres_per_second=2.0), path)
    return path


@pytest.fixture(scope="session")
def entities(rrd: Path, rows_by_entity: Callable[[Any], dict[str, Rows]]) -> dict[str, Rows]:
    """All rows of the file by entity."""
    from rerun.chunk import RrdReader

    return rows_by_entity(RrdReader(rrd).stream().to_chunks())


@pytest.fixture
def view_of(
    rows_by_entity: Callable[[Any], dict[str, Rows]], strict_rerun: None
) -> Callable[[Result], dict[str, Rows]]:
    """Give the rows by entity of a result's view."""
    from istc_replay.export.rerun.view import view_chunks

    return lambda result: rows_by_entity(view_chunks(result, ViewConfig(metres_per_second=2.0)))


@pytest.fixture(scope="session")
def hostile_result(synthetic_result: Result) -> Result:
    """A result whose every string is hostile: ids, paths, reasons, versions, settings."""
    hostile = renamed(synthetic_result, NASTY)
    left = {"vehicle_id": NASTY["car 2"] + "7", "reason": "<i>why</i>", "detail": NASTY["car 2"]}
    problem = {"code": "<u>code</u>", "detail": NASTY["car 1"], "offset": 12}
    first, *others = hostile.summary["windows"]
    source = {"path": "/logs/" + NASTY["car 1"], "sha256": "<s>", "complete": False, "problems": [problem]}
    summary = hostile.summary | {
        "input": source,
        "versions": {"<b>part</b>": "<b>1</b>"},
        "windows": [first | {"exclusions": [left], "reason": NASTY["car 1"]}, *others],
    }
    config = "# </code></pre><script>alert(3)</script> \ud800\n[window]\nunit_s = 1.0\n"
    return replace(hostile, summary=summary, config_toml=config)


@pytest.fixture(scope="session")
def moved_result() -> Callable[[Result], Result]:
    """Give the same result with plans a metre to the north, another setting and another version."""

    def moved(result: Result) -> Result:
        planned = pl.col("source") == "planned"
        states = result.states.with_columns(y_m=pl.col("y_m") + pl.when(planned).then(1.0).otherwise(0.0))
        summary = result.summary | {"versions": {"istc-replay": "<i>2</i>"}}
        settings = "[corridors]\ngap_max = 0.5\n"
        return replace(result, states=states, summary=summary, config_toml=settings)

    return moved


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Chromium without a window; nothing of it goes to another host."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    found = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    with playwright.sync_playwright() as driver:
        own = Path(driver.chromium.executable_path)
        if found is None and not own.exists():
            pytest.skip("no Chromium: install it, or run `playwright install chromium`")
        options = ["--no-sandbox", "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"]
        options += ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
        launched = driver.chromium.launch(executable_path=None if own.exists() else found, args=options)
        yield launched
        launched.close()


@pytest.fixture(scope="session")
def crowd(synthetic_result: Result) -> Result:
    """Fifty-one vehicles: the three of `synthetic_result` in seventeen places."""
    cars = ("car 1", "car 2", "car 3")
    copies = []
    for n in range(17):
        copy = renamed(synthetic_result, {car: f"{car[4]}{n:02d}" for car in cars})
        east, north = 60.0 * (n % 5), 60.0 * (n // 5)
        moved = {"states": ("x_m", "y_m"), "corridors": ("frame_x_m", "frame_y_m")}
        tables = {
            name: getattr(copy, name).with_columns(pl.col(x) + east, pl.col(y) + north)
            for name, (x, y) in moved.items()
        }
        copies.append(replace(copy, **tables))
    joined = {name: pl.concat([getattr(copy, name) for copy in copies]) for name in ("states", "corridors")}
    (window,) = synthetic_result.summary["windows"]
    vehicles = [vehicle for copy in copies for vehicle in copy.summary["windows"][0]["vehicles"]]
    summary = synthetic_result.summary | {"windows": [window | {"vehicles": vehicles}]}
    return replace(synthetic_result, **joined, summary=summary)


@pytest.fixture
def unpictured(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reports without pictures, for tests that read the words alone."""
    monkeypatch.setattr(report, "window_pictures", lambda _scene: Html(""))


@pytest.fixture(scope="session")
def document(synthetic_result: Result) -> str:
    """The report of the synthetic result."""
    return report_html(synthetic_result, "synthetic.mcap")


@pytest.fixture(scope="session")
def nasty_document(hostile_result: Result) -> str:
    """The report of a result whose every string is hostile."""
    return report_html(hostile_result, "</title><script>alert(4)</script>")
