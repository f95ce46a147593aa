"""The fleet's page in a real browser, with ten thousand logs."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from istc_replay.export.fleet_page import Distribution, FleetFigures, fleet_page
from istc_replay.export.fleet_page.histogram import histogram
from istc_replay.fleet.figures import LOGS_SCHEMA
from istc_replay.states import ENCOUNTERS_SCHEMA

COUNT = 10_000
HOSTILE = "</script><img src=x onerror=alert(1)> & \u202e'\""


def figures(count: int) -> FleetFigures:
    """A fleet of so many logs; the first has a hostile name and reason."""
    random = np.random.default_rng(0)
    names = [HOSTILE, *(f"log_{i:05d}" for i in range(1, count))]
    outcomes = ["failed", *random.choice(["done", "inconclusive", "failed"], count - 1, p=[0.9, 0.05, 0.05])]
    logs = pl.DataFrame(
        {
            "log": names,
            "location": names,
            "outcome": outcomes,
            "error": ["" if o == "done" else f"reason of {n}" for n, o in zip(names, outcomes, strict=True)],
            "severity": random.choice(["minor", "serious", "critical"], count),
            "critical": random.integers(0, 9, count),
            "windows": np.arange(count),
            "least_ttc_s": random.uniform(0, 9, count),
            "page": ["report.html" if o == "done" else None for o in outcomes],
        },
        schema_overrides={"page": pl.String},
    )
    logs = logs.with_columns(
        pl.lit(None, dtype=dtype).alias(name)
        for name, dtype in LOGS_SCHEMA.items()
        if name not in logs.columns
    )
    encounter = dict.fromkeys(ENCOUNTERS_SCHEMA.names())
    encounter |= {
        "log": HOSTILE,
        "window": 3,
        "page": "report.html",
        "severity": "critical",
        "rules": ["ttc"],
    }
    encounter |= {"first": HOSTILE, "second": "b", "worst_ns": 1_700_000_000_000_000_000, "least_gap_m": -0.5}
    finding = {"rule": HOSTILE, "critical": 1, "serious": 0, "minor": 0, "in_doubt": 0, "logs": 1}
    problem = {"code": HOSTILE, "kind": "reading", "logs": 1, "cases": 2, "example": HOSTILE}
    return FleetFigures(
        title=HOSTILE,
        call=[("Logs", str(count))],
        logs=logs,
        findings=pl.DataFrame([finding]),
        encounters=pl.DataFrame([encounter]),
        encounters_left_out=7,
        quality=pl.DataFrame([problem]),
        distributions={"All": [Distribution("Least TTC", "s", logs["least_ttc_s"], "An encounter.")]},
    )


@pytest.fixture(scope="module")
def page_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of ten thousand logs, as a file."""
    file = tmp_path_factory.mktemp("fleet") / "index.html"
    file.write_text(fleet_page(figures(COUNT)), encoding="utf-8")
    return file


@pytest.fixture
def page(browser: Any, page_file: Path) -> Any:
    """The page, opened; `complaints` and `asked` tell what the browser said and loaded."""
    opened = browser.new_context(viewport={"width": 1400, "height": 900}).new_page()
    opened.complaints, opened.asked = [], []
    opened.on("request", lambda request: opened.asked.append(request.url))
    opened.on("console", lambda message: opened.complaints.append(message.text))
    opened.on("pageerror", lambda error: opened.complaints.append(str(error)))
    opened.on("dialog", lambda dialog: opened.complaints.append(dialog.message))
    opened.goto(page_file.as_uri())
    return opened


def shown(page: Any, column: int = 0) -> list[str]:
    """What a column of the logs' table shows of the rows that are in the page."""
    cells = f"[data-rows=logs] tbody tr:not(.spacer) > :nth-child({column + 1})"
    return [str(text) for text in page.locator(cells).all_inner_texts()]


def test_ten_thousand_logs_filter_and_sort_with_few_rows_in_the_page(page: Any) -> None:
    count = page.locator("[data-rows=logs] output")
    assert count.inner_text() == f"{COUNT} of {COUNT}"
    assert shown(page)[1] == "log_00001"
    windows = page.locator("[data-rows=logs] th:nth-child(8) button")
    page.locator("[data-rows=logs] input").fill("log_0999")
    assert count.inner_text() == f"10 of {COUNT}"
    assert shown(page) == [f"log_0999{i}" for i in range(10)]
    page.locator("[data-rows=logs] input").fill("")
    page.locator("[data-rows=logs] select").first.select_option("failed")
    assert set(shown(page, 1)) == {"failed"}
    page.locator("[data-rows=logs] select").first.select_option("")
    windows.click()
    assert shown(page)[0] == f"log_{COUNT - 1:05d}"
    windows.click()
    assert shown(page)[1] == "log_00001"
    page.get_by_role("button", name="worst finding").click()
    assert set(shown(page, 2)) == {"critical"}
    page.locator("[data-rows=logs] .pane").evaluate("pane => { pane.scrollTop = pane.scrollHeight }")
    page.wait_for_function(
        "() => document.querySelector('[data-rows=logs] tbody').innerText.includes('minor')"
    )
    assert page.locator("[data-rows=logs] tbody tr").count() < 100
    assert page.complaints == []


def test_the_page_asks_for_nothing_and_shows_hostile_names_as_text(page: Any, page_file: Path) -> None:
    assert page.asked == [page_file.as_uri()]
    assert page.complaints == []
    assert page.locator("img").count() == 0
    assert shown(page)[0] == HOSTILE.replace("\u202e", "\\u202e")
    link = page.locator("[data-rows=encounters] a").first
    assert link.get_attribute("href") == (
        "../logs/%3C/script%3E%3Cimg%20src%3Dx%20onerror%3Dalert%281%29%3E%20%26%20%E2%80%AE%27%22/report.html#window-3"
    )
    policy = page.locator("meta[http-equiv]").get_attribute("content")
    assert "default-src 'none'" in policy
    assert "script-src 'sha256-" in policy


def test_axe_finds_no_serious_violation(page: Any) -> None:
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe is not installed")
    found = axe.Axe().run(page).response
    grave = [
        (violation["id"], [node["html"][:200] for node in violation["nodes"][:3]])
        for violation in found["violations"]
        if violation["impact"] in ("serious", "critical")
    ]
    assert grave == []


@pytest.mark.parametrize("log", [False, True])
def test_the_bars_of_a_distribution_hold_every_value(log: bool) -> None:
    values = pl.Series([0.01, 0.02, 0.5, 3.0, 3.0, 900.0, None, float("inf")])
    markup = histogram(Distribution("Time", "s", values, "A log.", (0.0, 5.0), log))
    counts = [int(count) for count in re.findall(r": (\d+)</title>", markup)]
    assert sum(counts) == 6
    assert "6 values; median 1.75" in markup
    assert "2 without one" in markup
    assert ("1 beyond the bars" in markup) == (not log)


def test_a_distribution_without_values_says_so() -> None:
    assert "There is none." in histogram(Distribution("Time", "s", pl.Series([], dtype=pl.Float64), ""))
    assert "No value was judged." in histogram(
        Distribution("T", "s", pl.Series([None], dtype=pl.Float64), "")
    )
    assert "5 values" in histogram(Distribution("T", "s", pl.Series([2.0] * 5), ""))
