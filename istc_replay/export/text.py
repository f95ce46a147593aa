"""Untrusted text made showable, whatever shows it."""

from __future__ import annotations


def visible(text: str) -> str:
    r"""Return text with its unprintable characters written out, as \n or \u202e.

    Control characters, lone surrogates and marks that turn the writing direction would be
    invisible, unwritable, or reorder what stands around them.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def shortened(text: str, characters: int) -> str:
    """Cut a long text in its middle."""
    if len(text) <= characters:
        return text
    tail = characters // 3
    return f"{text[: characters - tail - 1]}…{text[-tail:]}"
