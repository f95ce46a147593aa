"""The report: complete, alike every time, and inert whatever the log's names are."""

from __future__ import annotations

import itertools
import re
import xml.etree.ElementTree as ET
from dataclasses import replace

import polars as pl

from istc_replay.datatypes import Result
from istc_replay.export.report import report_html

from ..support.pages import Page
from ..support.results import with_window

TAGS = """
    html head meta title style body main section h1 h2 h3 p a dl div dt dd table caption thead tbody tr th td
    span bdi details summary pre code figure figcaption svg g defs path clippath rect use text pattern
"""
ATTRIBUTES = """
    lang charset http-equiv content name class id href scope title style role aria-label tabindex
    viewbox d transform
    x y width height clip-path patternunits fill stroke stroke-width stroke-linecap stroke-linejoin
    fill-opacity stroke-opacity stroke-dasharray opacity
"""


def test_the_same_result_gives_the_same_text(synthetic_result: Result, document: str) -> None:
    assert report_html(synthetic_result, "synthetic.mcap") == document


def test_every_vehicle_window_certificate_and_version_appears(
    synthetic_result: Result, document: str
) -> None:
    words = Page(document).words
    summary = synthetic_result.summary
    for window in summary["windows"]:
        assert f"Window {window['index']}" in words
        assert f'id="window-{window["index"]}"' in document
        for vehicle in window["vehicles"]:
            assert vehicle["id"] in words
        for figure in ("27.2000", "27.1800", "0.100 %", "tree"):
            assert figure in words
    for row in synthetic_result.certificates.iter_rows(named=True):
        assert row["check"] in words
        assert row["detail"] in words
    for row in synthetic_result.solves.iter_rows(named=True):
        assert row["solver"] in words
    for part, version in summary["versions"].items():
        assert part in words
        assert version in words
    assert "unit_s = 1.0" in words
    assert summary["input"]["sha256"][:16] in words


def test_exclusions_problems_and_undrivable_vehicles_appear_with_their_reasons(
    synthetic_result: Result, unpictured: None
) -> None:
    left = {"vehicle_id": "van 9", "reason": "short_presence", "detail": "present for 1 unit, 2 are needed"}
    stuck = {"vehicle_id": "car 2", "unit": 3, "slack_m": 0.131, "detail": "sticks out at 3.4 s"}
    source = synthetic_result.summary["input"] | {
        "complete": False,
        "problems": [{"code": "clock_step", "detail": "stamps step back by 2 s", "offset": 771}],
    }
    changed = with_window(
        synthetic_result, exclusions=[left], undrivable=[stuck], status="not_drivable", vehicles_present=4
    )
    words = Page(report_html(replace(changed, summary=changed.summary | {"input": source}), "x")).words
    for fact in (
        *left.values(),
        "sticks out at 3.4 s",
        "0.131",
        "clock_step",
        "stamps step back by 2 s",
        "771",
    ):
        assert fact in words
    assert "not complete" in words
    assert "Vehicles present 4 Plannable 3 Certified 3" in words


def test_hostile_names_stay_text(nasty_document: str) -> None:
    page = Page(nasty_document)
    assert not page.open
    assert {tag for tag, _ in page.elements} <= set(TAGS.split())
    assert {key for _, attributes in page.elements for key in attributes} <= set(ATTRIBUTES.split())
    assert "<script>alert(1)</script>" in page.words
    assert "</code></pre><script>alert(3)</script> \\ud800" in page.words
    assert "</title><script>alert(4)</script>" in page.words
    assert "\\u202e" in page.words
    assert not any(mark in nasty_document for mark in "\u202e\u200f\x00\ud800")
    nasty_document.encode("utf-8")


def test_long_names_are_cut(nasty_document: str, document: str) -> None:
    assert "X" * 300 not in nasty_document
    assert len(nasty_document) < len(document) + 50_000


def test_nothing_is_loaded_and_nothing_runs(document: str, nasty_document: str) -> None:
    for text in (document, nasty_document):
        page = Page(text)
        policy = next(m["content"] for m in page.all("meta") if m.get("http-equiv"))
        assert policy is not None
        assert policy.startswith("default-src 'none'")
        assert "script" not in policy
        for _, attributes in page.elements:
            assert not {"src", "srcset", "action", "data", "xlink:href"} & set(attributes)
            assert not any(key.startswith("on") for key in attributes)
            assert (attributes.get("href") or "#").startswith("#")
            assert "url(" not in re.sub(r"url\(#[\w-]+\)", "", attributes.get("style") or "")
        css = re.findall(r"<style>(.*?)</style>", text, re.DOTALL)
        assert len(css) == 1
        assert "url(" not in css[0]
        assert "@import" not in css[0]
    assert "://" not in document


def test_inlined_pictures_are_well_formed_and_share_no_identifier(synthetic_result: Result) -> None:
    windows = [synthetic_result.summary["windows"][0] | {"index": index} for index in (0, 1)]

    def both(table: pl.DataFrame) -> pl.DataFrame:
        return pl.concat([table, table.with_columns((pl.col("window") + 1).alias("window"))])

    twice = replace(
        synthetic_result,
        summary=synthetic_result.summary | {"windows": windows},
        states=both(synthetic_result.states),
        corridors=both(synthetic_result.corridors),
    )
    text = report_html(twice, "x")
    pictures = re.findall(r"<svg.*?</svg>", text, re.DOTALL)
    assert len(pictures) == 12
    defined: list[str] = []
    for picture in pictures:
        root = ET.fromstring(picture)  # noqa: S314
        own = [node.attrib["id"] for node in root.iter() if "id" in node.attrib]
        referred = re.findall(r"url\(#([^)]*)\)", picture) + re.findall(r'href="#([^"]*)"', picture)
        assert set(referred) <= set(own)
        assert root.attrib["role"] == "img"
        assert len(root.attrib["aria-label"]) > 20
        defined += own
    assert len(defined) == len(set(defined)) > 20


def test_pictures_follow_the_theme(document: str) -> None:
    picture = next(iter(re.findall(r"<svg.*?</svg>", document, re.DOTALL)))
    assert "var(--ink)" in picture
    assert "#1e2329" not in picture
    assert "prefers-color-scheme:dark" in document
    assert "@media print" in document


def test_the_document_can_be_read_aloud(document: str) -> None:
    page = Page(document)
    assert page.all("html")[0]["lang"] == "en"
    assert all(cell.get("scope") in ("row", "col") for cell in page.all("th"))
    assert len(page.all("caption")) == len(page.all("table"))
    assert len(page.all("figure")) == len(page.all("figcaption")) == len(page.all("svg")) == 6
    levels = [int(tag[1]) for tag, _ in page.elements if tag in ("h1", "h2", "h3")]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(after <= before + 1 for before, after in itertools.pairwise(levels))
