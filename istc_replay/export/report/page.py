"""The page around the report: one file that loads nothing, and runs at most its own script."""

from __future__ import annotations

import base64
import hashlib

from istc_replay.export.figures.style import GRID, INK, MUTED, PAPER
from istc_replay.export.report.markup import Content, Html, element

#: Nothing may be loaded from anywhere, no other script may run; styles stand in the page itself.
_POLICY = "default-src 'none'; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'"

#: The pictures' own colours, as variables of the page's theme.
THEME = {INK: "var(--ink)", MUTED: "var(--muted)", GRID: "var(--grid)", PAPER: "var(--paper)"}

_LIGHT = (
    "--ink:#1e2329;--muted:#5d6570;--grid:#d3d7dc;--paper:#ffffff;--card:#f5f6f8;"
    "--good:#0b6b4c;--good-ground:#e4f4ed;--bad:#a3241a;--bad-ground:#fbe9e6;"
    "--open:#7a5200;--open-ground:#fbf1dc;--link:#0a58a8"
)
_DARK = (
    "--ink:#e7eaee;--muted:#a3abb6;--grid:#3a414b;--paper:#14171b;--card:#1d2127;"
    "--good:#63d2a5;--good-ground:#12302a;--bad:#ff9c8f;--bad-ground:#3a1d1b;"
    "--open:#f0c46a;--open-ground:#33290f;--link:#7cb8f5"
)
_STYLE = f"""
:root{{color-scheme:light dark;{_LIGHT}}}
@media (prefers-color-scheme:dark){{:root{{{_DARK}}}}}
*{{box-sizing:border-box}}
body{{margin:0 auto;padding:1.5rem 2rem 4rem;max-width:72rem;background:var(--paper);color:var(--ink);
font:16px/1.5 system-ui,sans-serif;overflow-wrap:anywhere}}
h1{{font-size:1.7rem;line-height:1.25;margin:0 0 .75rem}}
h2{{font-size:1.3rem;margin:2.25rem 0 .6rem}}
h3{{font-size:1.05rem;margin:1.6rem 0 .4rem}}
p{{margin:.4rem 0}}
a{{color:var(--link)}}
dl{{display:grid;grid-template-columns:repeat(auto-fill,minmax(13rem,1fr));gap:.6rem 1.5rem;margin:.75rem 0}}
dl .row{{grid-column:1/-1}}
dt{{font-size:.8rem;color:var(--muted)}}
dd{{margin:0}}
.name{{white-space:pre-wrap;overflow-wrap:normal}}
.long{{overflow-wrap:anywhere}}
.hash{{font-family:ui-monospace,monospace;font-size:.92em}}
.wide{{overflow-x:auto}}
table{{border-collapse:collapse;width:100%;margin:.5rem 0 1rem;font-size:.875rem;line-height:1.4}}
caption{{text-align:left;color:var(--muted);padding-bottom:.3rem}}
th,td{{overflow-wrap:break-word;text-align:left;vertical-align:top;
padding:.25rem .75rem .25rem 0;border-bottom:1px solid var(--grid)}}
thead th{{color:var(--muted);font-weight:600;vertical-align:bottom;white-space:nowrap;overflow-wrap:normal}}
tbody th{{font-weight:600}}
.n{{text-align:right;font-variant-numeric:tabular-nums;white-space:nowrap}}
.verdict{{border-left:.35rem solid var(--open);background:var(--open-ground);padding:.7rem 1rem;
margin:.75rem 0 1rem;border-radius:.25rem}}
.verdict p:first-child{{margin-top:0;font-weight:650;font-size:1.05rem}}
.verdict.good{{border-color:var(--good);background:var(--good-ground)}}
.verdict.bad{{border-color:var(--bad);background:var(--bad-ground)}}
.good>p:first-child,td.good,span.good{{color:var(--good)}}
.bad>p:first-child,td.bad,span.bad{{color:var(--bad)}}
.open>p:first-child,td.open,span.open{{color:var(--open)}}
td span.good,td span.bad,td span.open{{font-weight:600}}
td span,th span{{white-space:nowrap}}
.swatch{{display:inline-block;width:.75em;height:.75em;margin-right:.4em;border:1px solid var(--muted)}}
figure{{margin:1.25rem 0;break-inside:avoid}}
figure svg{{display:block;width:100%;height:auto;font-family:system-ui,sans-serif}}
figure svg *{{stroke-linejoin:round;stroke-linecap:butt}}
@media screen and (max-width:44rem){{body{{padding:1rem 1rem 3rem}}figure svg{{min-width:44rem}}
caption{{position:sticky;left:0;max-width:calc(100vw - 2rem)}}}}
figcaption{{color:var(--muted);font-size:.875rem;margin-top:.3rem}}
details{{margin:.75rem 0;border-top:1px solid var(--grid);padding-top:.5rem}}
summary{{cursor:pointer;font-weight:600}}
pre{{white-space:pre-wrap;background:var(--card);padding:.75rem 1rem;font-size:.8rem;border-radius:.25rem}}
section.window{{border-top:2px solid var(--grid);margin-top:2.5rem}}
@media print{{:root{{color-scheme:light;{_LIGHT}}}body{{max-width:none;padding:0;font-size:11pt}}
.wide{{overflow:visible}}table{{font-size:8pt}}thead th,.n,td span{{white-space:normal}}
th,td,thead th,.name{{overflow-wrap:anywhere}}
tr{{break-inside:avoid}}h2,h3{{break-after:avoid}}}}
"""


def page(title: str, body: Content, script: str = "", style: str = "") -> str:
    """Return the whole document.

    Parameters
    ----------
    title : str
        Its title.
    body : Html and other contents
        What it shows.
    script, style : str
        A script that may run, and styles beside those of all pages; constants of the caller.
    """
    policy = _POLICY
    if script:
        digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
        policy += f"; script-src 'sha256-{digest}'"
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", http_equiv="Content-Security-Policy", content=policy),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("meta", name="referrer", content="no-referrer"),
        element("title", title),
        element("style", Html(_STYLE + style)),
    )
    code = element("script", Html(script)) if script else None
    whole = element("html", head, element("body", element("main", body), code), lang="en")
    return f"<!DOCTYPE html>\n{whole}\n"
