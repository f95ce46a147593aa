"""The report: complete, honest, alike every time, and inert whatever the log's names are."""

from __future__ import annotations

import itertools
import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from html.parser import HTMLParser
from typing import Any

import polars as pl
import pytest

from istc_replay.datatypes import Result
from istc_replay.export import report
from istc_replay.export.report import report_html
from istc_replay.export.report.markup import Html, element, join, name, names, number
from istc_replay.export.text import shortened, visible
from istc_replay.states import SOLVES_SCHEMA, conform

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
VOID = {"meta"}


class Page(HTMLParser):
    """A parsed page: elements with their attributes, the text between them, what stayed open."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.text: list[str] = []
        self.open: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag
        if tag in ("caption", "dd", "dt", "h1", "h2", "h3", "p", "td", "th", "title"):
            self.text.append(" ")

    def handle_data(self, data: str) -> None:
        if not self.open or self.open[-1] != "style":
            self.text.append(data)

    def handle_comment(self, data: str) -> None:
        raise AssertionError(f"comment {data}")

    @property
    def words(self) -> str:
        return " ".join("".join(self.text).split())

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for found, attributes in self.elements if found == tag]


def with_window(result: Result, **changes: Any) -> Result:
    """The same result with another first window in its summary."""
    first, *others = result.summary["windows"]
    return replace(result, summary=result.summary | {"windows": [first | changes, *others]})


def proven(result: Result) -> Result:
    """The same result, all of whose checks pass."""
    checks = result.certificates.head(2).with_columns(
        pl.lit("pass").alias("verdict"),
        pl.lit(0.4).alias("margin"),
        pl.Series("check", ["cubes_disjoint", "separation"]),
    )
    return replace(result, certificates=checks)


@pytest.fixture
def unpictured(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reports without pictures, for tests that read the words alone."""
    monkeypatch.setattr(report, "window_pictures", lambda _scene: Html(""))


@pytest.fixture(scope="module")
def document(synthetic_result: Result) -> str:
    """The report of the synthetic result."""
    return report_html(synthetic_result, "synthetic.mcap")


@pytest.fixture(scope="module")
def nasty_document(hostile_result: Result) -> str:
    """The report of a result whose every string is hostile."""
    return report_html(hostile_result, "</title><script>alert(4)</script>")


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


# --- verdicts --------------------------------------------------------------------------------


def test_a_certified_window_says_what_is_proven_and_both_least_gaps(
    synthetic_result: Result, unpictured: None
) -> None:
    words = Page(report_html(proven(synthetic_result), "x")).words
    assert "✓ Certified: 3 of 3 plannable vehicles have plans that pass every check; 3 are present." in words
    assert "no two planned boxes touch at any instant" in words
    assert "as recorded: 4.20 m, vehicles car 1 and car 2 at 5.00 s." in words
    assert "as planned: 0.40 m, vehicles car 3 at 5.40 s." in words
    assert "Not certified" not in words


def test_the_planned_gap_counts_from_the_distance_asked_for(
    synthetic_result: Result, unpictured: None
) -> None:
    asked = replace(proven(synthetic_result), config_toml="[certificate]\nseparation_m = 0.5\n")
    assert "as planned: 0.90 m" in Page(report_html(asked, "x")).words


def test_a_failing_check_outweighs_the_status(document: str) -> None:
    words = Page(document).words
    assert "✗ Not certified, although its status says so" in words
    assert "checks that fail: dynamics." in words
    assert "✓ Certified" not in words


def test_a_status_without_any_check_is_not_believed(synthetic_result: Result, unpictured: None) -> None:
    unchecked = replace(synthetic_result, certificates=synthetic_result.certificates.clear())
    words = Page(report_html(unchecked, "x")).words
    assert "no check was made" in words
    assert "✓ Certified" not in words


def test_a_window_that_ends_away_from_a_goal_shows_its_plan_and_says_so(synthetic_result: Result) -> None:
    late = with_window(
        proven(synthetic_result), status="goal_not_reached", reason="goal not reached: a by 1.2 m"
    )
    words = Page(report_html(late, "x")).words
    assert "Not everybody reaches its goal" in words
    assert "Reason: goal not reached: a by 1.2 m" in words
    assert "as planned" in words


@pytest.mark.parametrize(
    "status", ["conflict_left", "no_corridors", "not_drivable", "nothing_to_plan", "unheard_of"]
)
def test_a_window_without_a_plan_gives_its_reason_and_shows_none(
    synthetic_result: Result, status: str
) -> None:
    unsolved = with_window(synthetic_result, status=status, reason="car 1 and car 2 start in each other")
    text = report_html(unsolved, "x")
    words = Page(text).words
    assert "No plan" in words
    assert "Reason: car 1 and car 2 start in each other" in words
    assert "as planned" not in words
    assert "Proven" not in words
    pictures = "".join(re.findall(r"<svg.*?</svg>", text, re.DOTALL))
    assert "planned" not in pictures
    assert "-corridors-" not in pictures


# --- many of everything ----------------------------------------------------------------------


def test_pictures_are_drawn_of_twelve_windows_at_most(
    synthetic_result: Result, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = []

    def stub(scene: Any) -> Html:
        drawn.append(scene.window["index"])
        return Html("")

    monkeypatch.setattr(report, "window_pictures", stub)
    first = synthetic_result.summary["windows"][0]
    windows = [first | {"index": n, "status": "no_corridors" if n > 250 else "certified"} for n in range(300)]
    checks = proven(synthetic_result).certificates
    every = pl.concat([checks.with_columns(pl.lit(n, pl.Int32).alias("window")) for n in range(251)])
    many = replace(
        synthetic_result, summary=synthetic_result.summary | {"windows": windows}, certificates=every
    )
    text = report_html(many, "x")
    words = Page(text).words
    assert drawn == [0, 1, 2, 3, 4, 5, 251, 252, 253, 254, 255, 256]
    assert "Pictures are drawn of 12 windows" in words
    assert "288 more have none here" in words
    assert len(text) < 3_000_000
    for index in range(300):
        assert f'href="#window-{index}"' in text
        assert f'id="window-{index}"' in text


def test_many_solves_are_summed_up(synthetic_result: Result, unpictured: None) -> None:
    solve = {"window": 0, "layer": "trajectory", "stage": "nlp", "solver": "ipopt", "status": "optimal"}
    rows = [solve | {"vehicle_id": f"v{n}", "iterations": 7, "wall_s": 0.5} for n in range(40)]
    table = conform(pl.DataFrame(rows), SOLVES_SCHEMA)
    words = Page(report_html(replace(synthetic_result, solves=table), "x")).words
    assert "40 solves, summed up" in words
    assert "trajectory nlp ipopt optimal 40 280" in words
    assert "20.000" in words


def test_what_coordination_changed_is_told_of_those_that_it_changed(
    synthetic_result: Result, unpictured: None
) -> None:
    same = {
        "changed": False,
        "delay_s": 0.0,
        "deviation_m": 0.0,
        "clearance_m": 3.0,
        "clearance_gained_m": 0.0,
    }
    moved = {
        "changed": True,
        "delay_s": -0.0004,
        "deviation_m": 1.234,
        "lateral_m": 0.5,
        "acceleration_rms_mps2": -0.11,
        "braking_mps2": 0.25,
        "clearance_m": 0.75,
        "clearance_gained_m": 0.314,
    }
    bound = {"bound": "road", "margin_m": 0.17, "excursion_m": 0.5, "recorded_off_road_m": 0.21}
    vehicles = synthetic_result.summary["windows"][0]["vehicles"]
    told = [v | {"coordination": moved if v["id"] == "car 2" else same, "lateral": None} for v in vehicles]

    def words(rows: list[dict[str, Any]]) -> str:
        return Page(report_html(with_window(synthetic_result, vehicles=rows), "x")).words

    scene = words(told)
    assert "2 of 3 plans are the guidance: vehicles car 1 and car 3." in scene
    assert "car 2 0.00 1.23 0.50 −0.11 0.25 0.75 0.31 Vehicles" in scene
    traffic = words([v | {"lateral": bound} if v["id"] == "car 2" else v for v in told])
    assert "are the recording, made drivable" in traffic
    assert "car 2 0.00 1.23 0.50 −0.11 0.25 0.75 0.31 0.17 the road's edge" in traffic
    assert "Recorded beyond the road's edge: car 2 by 0.21 m." in traffic
    assert "Nothing: 3 of 3 plans are the guidance." in words([v | {"coordination": same} for v in vehicles])
    assert "What coordination changed" not in words(vehicles)


def test_a_result_without_windows_is_still_a_report(synthetic_result: Result) -> None:
    bare = {"windows": [], "input": None, "totals": None, "versions": None}
    empty = replace(
        synthetic_result,
        summary=bare,
        states=synthetic_result.states.clear(),
        certificates=synthetic_result.certificates.clear(),
    )
    assert "The log has no window to plan." in Page(report_html(empty, "x")).words


# --- markup ----------------------------------------------------------------------------------


def test_strings_are_escaped_unless_they_are_markup() -> None:
    assert element("p", "<b>", Html("<i></i>"), None, 3, ["&"]) == "<p>&lt;b&gt;<i></i>3&amp;</p>"
    assert element("p", title='"><b>', hidden=True, lang=None) == '<p title="&quot;&gt;&lt;b&gt;" hidden></p>'
    assert join(["<", Html("<br>")]) == "&lt;<br>"


def test_unprintable_characters_are_written_out() -> None:
    assert visible("a\tb\u202e\ud800\x00") == "a\\tb\\u202e\\ud800\\x00"
    assert visible("שלום, 東京 – é") == "שלום, 東京 – é"


def test_names_are_isolated_cut_and_joined() -> None:
    assert name("a") == '<bdi class="name">a</bdi>'
    assert len(name("v" * 5000)) < 600
    assert shortened("0123456789", 7) == "0123…89"
    assert re.sub("<.*?>", "", names("abc")) == "a, b and c"
    assert re.sub("<.*?>", "", names("abcde", most=2)) == "a, b and 3 more"


def test_numbers_that_are_not_there_are_a_dash() -> None:
    assert number(None) == number(float("nan")) == number("7") == number(True) == "–"
    assert number(-1.234, 2, "m") == "−1.23 m"
    assert number(0.0) == "0.00"
    assert number(1.5e-12, 4) == "1.5e−12"
    assert number(12) == "12"
