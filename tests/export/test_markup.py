"""The markup of pages: strings stay text."""

from __future__ import annotations

import re

from istc_replay.export.report.markup import Html, element, join, name, names, number
from istc_replay.export.text import shortened, visible


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
