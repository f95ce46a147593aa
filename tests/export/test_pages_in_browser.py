"""The pages in a real browser: for those who listen, on phones, in the dark, on paper, offline."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import polars as pl
import pytest

import istc_replay
from istc_replay.comparison.compare import compare_results
from istc_replay.datatypes import Result
from istc_replay.export.audit import audit_html
from istc_replay.export.report import report_html
from istc_replay.export.report.beside import comparison_html
from istc_replay.safety.log_audit import Audit

DESKTOP, PHONE = {"width": 1280, "height": 900}, {"width": 390, "height": 844}


def collision(result: Result) -> Audit:
    """The audit of a result in which two vehicles drive into each other as recorded."""
    recorded = pl.col("source") == "recorded"
    first, second = sorted(result.states.filter(recorded)["vehicle_id"].unique())[:2]
    one, two = (recorded & (pl.col("vehicle_id") == name) for name in (first, second))
    way = (pl.col("time_ns") - pl.col("time_ns").min()) / 1e9 * 8.0 - 20.0
    driven = {"x_m": (way, 0.0), "y_m": (0.0, way), "heading_rad": (0.0, 1.57), "speed_mps": (8.0, 8.0)}
    states = result.states.with_columns(
        pl.when(one).then(a).when(two).then(b).otherwise(pl.col(name)).alias(name)
        for name, (a, b) in driven.items()
    )
    audit = istc_replay.audit(replace(result, states=states))
    assert "critical" in set(audit.encounters["severity"])
    return audit


@pytest.fixture(scope="module")
def pages(
    synthetic_result: Result,
    hostile_result: Result,
    moved_result: Callable[[Result], Result],
    tmp_path_factory: pytest.TempPathFactory,
) -> dict[str, Path]:
    """Report and comparison, of plain and of hostile names, as files."""
    folder = tmp_path_factory.mktemp("pages")
    texts = {"report": report_html(synthetic_result, "synthetic.mcap")}
    texts["hostile"] = report_html(hostile_result, "</title><script>document.title = 'run'</script>")
    other = moved_result(hostile_result)
    titles = ("<script>document.title = 'run'</script>", '"><img src=x onerror=alert(1)>')
    texts["beside"] = comparison_html(compare_results(hostile_result, other), hostile_result, other, titles)
    texts["audit"] = audit_html(collision(hostile_result), {"<b>": Path("<i>.mcap")})
    for name, text in texts.items():
        (folder / f"{name}.html").write_text(text, encoding="utf-8")
    return {name: folder / f"{name}.html" for name in texts}


@pytest.fixture
def opened(browser: Any, pages: dict[str, Path]) -> Callable[..., Any]:
    """Open a page in a context of its own, and fail on whatever the browser complains of."""

    def open_page(name: str, **context: Any) -> Any:
        page = browser.new_context(**context).new_page()
        page.asked, page.complaints = [], []
        page.on("request", lambda request: page.asked.append(request.url))
        page.on("console", lambda message: page.complaints.append(message.text))
        page.on("pageerror", lambda error: page.complaints.append(str(error)))
        page.on("dialog", lambda dialog: page.complaints.append(dialog.message))
        page.goto(pages[name].as_uri())
        return page

    return open_page


@pytest.mark.parametrize("name", ["report", "hostile", "beside", "audit"])
@pytest.mark.parametrize(
    ("viewport", "scheme"), [(DESKTOP, "light"), (PHONE, "dark")], ids=["desktop-light", "phone-dark"]
)
def test_axe_finds_no_serious_violation(
    opened: Callable[..., Any], name: str, scheme: str, viewport: dict[str, int]
) -> None:
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe is not installed")
    page = opened(name, viewport=viewport, color_scheme=scheme)
    page.evaluate("document.querySelectorAll('details').forEach(folded => { folded.open = true })")
    found = axe.Axe().run(page).response
    assert found["testEngine"]["name"] == "axe-core"
    grave = [
        (violation["id"], [node["html"][:200] for node in violation["nodes"][:3]])
        for violation in found["violations"]
        if violation["impact"] in ("serious", "critical")
    ]
    assert grave == []


@pytest.mark.parametrize("name", ["report", "hostile", "beside", "audit"])
def test_a_page_asks_for_nothing_and_runs_nothing(
    opened: Callable[..., Any], pages: dict[str, Path], name: str
) -> None:
    page = opened(name, viewport=DESKTOP)
    assert page.asked == [pages[name].as_uri()]
    assert page.complaints == []
    assert page.title() != "run"
    assert page.evaluate("document.scripts.length + document.images.length") == 0


@pytest.mark.parametrize("name", ["report", "hostile", "beside", "audit"])
def test_a_page_fits_a_phone_and_a_sheet_of_paper(opened: Callable[..., Any], name: str) -> None:
    phone = opened(name, viewport=PHONE)
    assert phone.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
    paper = opened(name, viewport={"width": 718, "height": 1000})
    paper.emulate_media(media="print", color_scheme="dark")
    assert paper.evaluate("document.documentElement.scrollWidth") <= 718
    assert paper.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"


def test_pictures_stay_legible_on_a_phone(opened: Callable[..., Any]) -> None:
    phone = opened("report", viewport=PHONE)
    assert phone.evaluate("Math.min(...[...document.querySelectorAll('svg')].map(s => s.clientWidth))") >= 700


def test_pictures_change_with_the_theme(opened: Callable[..., Any]) -> None:
    ink = "getComputedStyle(document.querySelector('svg text')).fill"
    light, dark = (opened("report", color_scheme=scheme).evaluate(ink) for scheme in ("light", "dark"))
    assert light != dark
