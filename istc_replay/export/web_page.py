"""The page around Rerun's web viewer: what the scene shows, in words, and buttons to its instants.

It loads what stands beside it and nothing else, and it can be read and used without seeing the
scene. Names and details come from logs: they are escaped, and shown as the text that they are.
"""

from __future__ import annotations

from collections.abc import Sequence

from istc_replay.datatypes import Result
from istc_replay.export.report.markup import Content, Html, element
from istc_replay.export.rerun.chunks import label
from istc_replay.export.rerun.events import Event

_POLICY = (
    "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "connect-src 'self' blob: data:; img-src 'self' blob: data:; font-src 'self' data:; "
    "worker-src 'self' blob:; base-uri 'none'; form-action 'none'"
)
_EVENTS = 1000
#: More windows, or vehicles, are folded away.
_FOLDED = 24


def view_page(
    result: Result,
    events: Sequence[Event],
    comings: Sequence[Event],
    origin_ns: int,
    instant_ns: int,
    *,
    report: bool,
) -> str:
    """The document; `instant_ns`, from `origin_ns` on, is where the scene opens.

    Parameters
    ----------
    events : sequence of Event
        The log of events; of very many the worst are listed.
    comings : sequence of Event
        When each vehicle comes.
    report : bool
        Whether report.html stands beside it.
    """
    name = label(result.summary["input"]["path"].rsplit("/", 1)[-1])
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", http_equiv="Content-Security-Policy", content=_POLICY),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("meta", name="referrer", content="no-referrer"),
        element("title", f"Replay of {name}"),
        element("link", rel="stylesheet", href="view.css"),
        element("link", rel="icon", href="data:,"),
        element("script", src="re_viewer.js", defer=True),
        element("script", src="view.js", defer=True),
    )
    scene = element(
        "main",
        element("p", "The scene needs JavaScript and WebAssembly.", id="status", role="status"),
        element(
            "canvas",
            id="scene",
            role="img",
            tabindex="0",
            aria_label="Replay in Rerun: corridors in space and time, the scene from above, plots and states",
            aria_describedby="told",
        ),
    )
    body = element(
        "body",
        element("a", "Skip to the events", href="#events", class_="skip"),
        element("header", element("h1", f"Replay of {name}"), _totals(result, report)),
        scene,
        element(
            "aside",
            _windows(result, origin_ns),
            _folded("Vehicles", "vehicles, by the time when they come", comings, origin_ns),
            _list(events, origin_ns),
            aria_label="What happened",
        ),
        data_ns=str(instant_ns),
    )
    return f"<!DOCTYPE html>\n{element('html', head, body, lang='en')}\n"


def _totals(result: Result, report: bool) -> Content:
    totals = result.summary["totals"]
    told = (
        f"{totals['vehicles_certified']} of {totals['vehicles_plannable']} plannable vehicles certified, "
        f"{totals['windows_full']} of {totals['windows']} windows in full"
    )
    link = element("p", element("a", "Read the report", href="report.html")) if report else None
    return [element("p", told, id="told"), link]


def _windows(result: Result, origin_ns: int) -> Content:
    windows = [
        Event(
            w["start_ns"],
            "windows",
            "INFO" if w["status"] == "certified" else "WARN",
            f"Window {w['index']}: {w['status'].replace('_', ' ')}, {w['vehicles_certified']} of "
            f"{w['vehicles_plannable']} plannable vehicles certified",
        )
        for w in result.summary["windows"]
    ]
    return _folded("Windows", "windows", windows, origin_ns)


def _list(events: Sequence[Event], origin_ns: int) -> Content:
    shown = list(events)
    if len(shown) > _EVENTS:
        # Of very many, those that matter come first.
        order = {"CRITICAL": 0, "ERROR": 1, "WARN": 2, "INFO": 3}
        shown = sorted(sorted(shown, key=lambda event: order[event.level])[:_EVENTS])
    rows = [_row(event, origin_ns) for event in shown]
    if len(events) > _EVENTS:
        rows.append(element("li", f"and {len(events) - _EVENTS} lesser ones, in the scene's events"))
    return [
        element("h2", "Events and findings", id="events", tabindex="-1"),
        element("p", "A button sets the scene to its instant."),
        element("ul", *rows),
    ]


def _folded(heading: str, what: str, events: Sequence[Event], origin_ns: int) -> Content:
    """Instants as a list, folded away where there are many."""
    rows = element("ul", *(_row(event, origin_ns) for event in events))
    if len(events) > _FOLDED:
        rows = element("details", element("summary", f"{len(events)} {what}"), rows)
    return [element("h2", heading), rows]


def _row(event: Event, origin_ns: int) -> Html:
    seconds = (event.time_ns - origin_ns) / 1e9
    return element(
        "li",
        element(
            "button",
            f"{seconds:.1f} s",
            type="button",
            disabled=True,
            data_ns=str(event.time_ns - origin_ns),
            aria_label=f"Show {seconds:.1f} s",
        ),
        element("span", event.level.lower(), class_=event.level.lower()),
        " ",
        event.text,
    )
