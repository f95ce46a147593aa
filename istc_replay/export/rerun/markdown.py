"""Markdown of the Rerun view, in which untrusted text stays text.

Identifiers, paths and details come from logs: every character that Markdown or HTML could read as
markup is escaped, and long words are cut.
"""

from __future__ import annotations

from collections.abc import Sequence

from istc_replay.export.rerun.chunks import plain

#: So many rows of a table, or events of a kind, are shown.
ROWS = 60
_LONGEST = 200
_MARKUP = str.maketrans({c: f"\\{c}" for c in "\\`*_{}[]()<>#+-.!|~&$^=:\"'/"})


def escaped(text: object) -> str:
    """Untrusted text as Markdown that shows just these characters, on one line."""
    return cut(text, _LONGEST).translate(_MARKUP)


def cut(text: object, longest: int = 2 * _LONGEST) -> str:
    """Untrusted text on one line that the viewer can draw, of so many characters at most."""
    line = plain(text)
    return line if len(line) <= longest else line[: longest - 1] + "\N{HORIZONTAL ELLIPSIS}"


def number(value: float | None, form: str, unit: str = "") -> str:
    """A figure with its unit; a dash where there is none."""
    return "\N{EN DASH}" if value is None else f"{value:{form}}{unit}"


def table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    """A table of cells that are Markdown already."""
    lines = [head, ("---",) * len(head), *rows[:ROWS]]
    if len(rows) > ROWS:
        lines.append((f"and {len(rows) - ROWS} more", *("",) * (len(head) - 1)))
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
