"""HTML that is escaped unless it says otherwise: plain strings are text, `Html` is markup."""

from __future__ import annotations

import html
import math
from collections.abc import Iterable, Sequence
from typing import Any

from istc_replay.export.text import shortened, visible

#: Names longer than this are cut in the middle; their titles show a little more.
_NAME_CHARACTERS = 40
_TITLE_CHARACTERS = 240
_TEXT_CHARACTERS = 600
#: Up to this length a name is never broken.
_WORD_CHARACTERS = 24
_VOID = frozenset({"meta", "br", "img", "input"})

NOTHING = "–"


class Html(str):
    """Text that is already markup; everything else is escaped."""

    __slots__ = ()


Content = Any  # Html, str, number, None, or an iterable of these


def element(tag: str, *children: Content, **attributes: str | bool | None) -> Html:
    """Build one element.

    Parameters
    ----------
    tag : str
        Its name, a constant of the caller.
    *children : Html, str, number, None or iterables of these
        What it holds; strings are escaped, None is left out.
    **attributes : str or bool or None
        Its attributes; values are escaped, underscores of names become dashes and a trailing one
        is dropped, True is a bare attribute, None and False leave it out.
    """
    parts = []
    for name, value in attributes.items():
        if value is None or value is False:
            continue
        attribute = name.rstrip("_").replace("_", "-")
        parts.append(f" {attribute}" if value is True else f' {attribute}="{html.escape(visible(value))}"')
    opening = f"<{tag}{''.join(parts)}>"
    return Html(opening if tag in _VOID else f"{opening}{join(children)}</{tag}>")


def join(children: Iterable[Content], separator: str = "") -> Html:
    """Join contents; strings are escaped."""
    return Html(separator.join(_markup(child) for child in children))


def _markup(child: Content) -> str:
    if child is None:
        return ""
    if isinstance(child, Html):
        return str(child)
    if isinstance(child, str):
        return html.escape(visible(child))
    if isinstance(child, (int, float)):
        return html.escape(str(child))
    return join(child)


def name(text: Any) -> Html:
    """An untrusted name: isolated from the text around it, short, its title longer."""
    whole = visible(str(text)[:_TITLE_CHARACTERS]) + ("…" if len(str(text)) > _TITLE_CHARACTERS else "")
    short = shortened(visible(shortened(str(text), _NAME_CHARACTERS)), 2 * _NAME_CHARACTERS)
    kind = "name long" if len(short) > _WORD_CHARACTERS else "name"
    return element("bdi", short, class_=kind, title=None if short == whole else whole)


def names(texts: Iterable[Any], most: int = 12) -> Html:
    """Several names: a, b and c; past `most` the rest is counted."""
    values = list(texts)
    shown = [name(value) for value in values[:most]]
    if len(values) > most:
        return join([join(shown, ", "), f" and {len(values) - most} more"])
    if len(shown) > 1:
        return join([join(shown[:-1], ", "), " and ", shown[-1]])
    return join(shown)


def prose(text: Any) -> Html:
    """An untrusted sentence: isolated and at most a paragraph long."""
    shown = visible(shortened(str(text), _TEXT_CHARACTERS))
    longest = max(map(len, shown.split()), default=0)
    return element("bdi", shown, class_="long" if longest > _WORD_CHARACTERS else None)


def number(value: Any, digits: int = 2, unit: str = "") -> str:
    """A number with fixed decimals and its unit; a dash where there is none."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        return NOTHING
    if isinstance(value, int):
        text = str(value) if abs(value) < 10**15 else f"{value:.3g}"
    elif value != 0.0 and (abs(value) >= 1e7 or abs(value) < 0.5 * 10.0**-digits):
        text = f"{value:.3g}"
    else:
        text = f"{value:.{digits}f}"
    return f"{text.replace('-', '−')}{' ' + unit if unit else ''}"


def fixed(value: Any, digits: int) -> str:
    """A number with these decimals however small it is; a dash where there is none."""
    if isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < 0.5 * 10.0**-digits:
        value = 0.0
    return number(value, digits)


def table(
    caption: Content, headings: Sequence[str], rows: Iterable[Sequence[Content]], numeric: Iterable[int] = ()
) -> Html:
    """A table whose first column heads its rows; `numeric` columns are set right."""
    right = frozenset(numeric)
    head = element(
        "tr",
        [
            element("th", text, scope="col", class_="n" if i in right else None)
            for i, text in enumerate(headings)
        ],
    )
    body = [
        element(
            "tr",
            element("th", row[0], scope="row", class_="n" if 0 in right else None),
            [
                element("td", cell, class_="n" if i in right else None)
                for i, cell in enumerate(row[1:], start=1)
            ],
        )
        for row in rows
    ]
    return scrolled(
        element("table", element("caption", caption), element("thead", head), element("tbody", body)), "Table"
    )


def scrolled(content: Content, label: str) -> Html:
    """Content that may be wider than the screen: it scrolls by itself, by finger and by key."""
    return element("div", content, class_="wide", role="group", tabindex="0", aria_label=label)


def captioned(svg: Html, caption: Content) -> Html:
    """A picture with its caption."""
    return element("figure", scrolled(svg, "Picture"), element("figcaption", caption))


def facts(pairs: Iterable[tuple[str, Content]]) -> Html:
    """A list of named values; those that are None are left out."""
    shown = [(title, value) for title, value in pairs if value is not None]
    return element(
        "dl", [element("div", element("dt", title), element("dd", value)) for title, value in shown]
    )
