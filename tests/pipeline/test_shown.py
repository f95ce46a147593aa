"""What the functions of the package return shows itself, and is still the plain data."""

from __future__ import annotations

import base64
import re
from dataclasses import fields, replace
from typing import Any

import polars as pl
import pytest

import istc_replay
from istc_replay.datatypes import Result
from istc_replay.pipeline.shown import ShownResult, shown_result

from ..support.results import renamed


@pytest.fixture(scope="module")
def loaded(synthetic_bytes: bytes, tmp_path_factory: pytest.TempPathFactory) -> Result:
    """The synthetic result as a user loads it."""
    path = tmp_path_factory.mktemp("shown") / "result.mcap"
    path.write_bytes(synthetic_bytes)
    return istc_replay.load_result(path)


def html(shown: Any) -> str:
    """What a notebook shows of it."""
    text: str = shown._repr_html_()
    return text


def test_a_shown_result_holds_the_same_data(loaded: Result, synthetic_result: Result) -> None:
    assert isinstance(loaded, Result)
    for field in fields(Result):
        of_shown, of_plain = getattr(loaded, field.name), getattr(synthetic_result, field.name)
        if isinstance(of_plain, pl.DataFrame):
            assert of_shown.equals(of_plain)
        elif field.name in ("summary", "config_toml"):
            assert of_shown == of_plain
    assert isinstance(replace(loaded, path="elsewhere"), ShownResult)


def test_a_result_is_one_line_in_a_console(loaded: Result) -> None:
    assert repr(loaded).startswith("Result of ")
    assert "\n" not in repr(loaded)
    assert "3 of 3 plannable vehicles certified" in repr(loaded)


def test_a_result_shows_windows_vehicles_and_pictures(loaded: Result) -> None:
    text = html(loaded)
    for vehicle in ("car 1", "car 2", "car 3"):
        assert f">{vehicle}</bdi>" in text
    pictures = re.findall(r'<img src="data:image/png;base64,([^"]+)" alt="([^"]+)">', text)
    assert [alternative[:9] for _, alternative in pictures] == ["Corridors", "Trajector"]
    assert all(base64.b64decode(data).startswith(b"\x89PNG") for data, _ in pictures)
    assert "<script" not in text


def test_the_bundle_has_what_is_asked_for(loaded: Any) -> None:
    assert set(loaded._repr_mimebundle_()) == {"text/plain", "text/html"}
    assert set(loaded._repr_mimebundle_(include={"text/plain"})) == {"text/plain"}
    assert set(loaded._repr_mimebundle_(exclude={"text/html"})) == {"text/plain"}


def test_an_audit_shows_its_verdict_and_findings(loaded: Result) -> None:
    audit = istc_replay.audit(loaded)
    assert repr(audit).startswith("Audit of ")
    text = html(audit)
    assert str(audit.verdict) in text
    assert text.count("<tr>") > audit.coverage["rule"].n_unique()


def test_a_comparison_shows_what_differs(loaded: Result) -> None:
    north = pl.when(pl.col("source") == "planned").then(2.5).otherwise(0.0)
    moved = replace(loaded, states=loaded.states.with_columns(y_m=pl.col("y_m") + north))
    comparison = istc_replay.compare(loaded, moved)
    assert "3 plans moved, by up to 2.50 m" in repr(comparison)
    assert ">2.50</td>" in html(comparison)
    assert "Nothing differs" in html(istc_replay.compare(loaded, loaded))


def test_hostile_names_stay_text(loaded: Result) -> None:
    nasty = "<script>alert(1)</script>\u202e\n" + "X" * 10_000
    hostile = renamed(loaded, {"car 1": nasty})
    shown = shown_result(replace(hostile, summary=hostile.summary | {"input": {"path": nasty}}))
    for text in (
        repr(shown),
        html(shown),
        html(istc_replay.audit(shown)),
        html(istc_replay.compare(loaded, shown)),
    ):
        assert "\u202e" not in text
        assert "X" * 300 not in text
    for text in (html(shown), html(istc_replay.audit(shown)), html(istc_replay.compare(loaded, shown))):
        assert "<script" not in text
