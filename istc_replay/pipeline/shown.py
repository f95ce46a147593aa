"""Results, audits and comparisons that show themselves in a notebook.

The data types themselves are plain and know no output. What `istc_replay.replay`, `load_result`, `audit`
and `compare` return are these subclasses: they hold the same data and ask the export layer for their
looks.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from istc_replay.comparison.difference import Comparison
from istc_replay.comparison.words import sentences
from istc_replay.datatypes import Result
from istc_replay.export.text import visible
from istc_replay.safety.log_audit import Audit


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ShownResult(Result):
    """A result, with its looks: one line in a console, tables and pictures in a notebook."""

    def __repr__(self) -> str:
        from istc_replay.export.notebook import result_text

        return result_text(self)

    def _repr_html_(self) -> str:
        from istc_replay.export.notebook import result_html

        return result_html(self)

    def _repr_mimebundle_(self, include: Any = None, exclude: Any = None) -> dict[str, str]:
        return _wanted({"text/plain": repr(self), "text/html": self._repr_html_()}, include, exclude)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ShownAudit(Audit):
    """An audit, with its looks: one line in a console, tables in a notebook."""

    def __repr__(self) -> str:
        from istc_replay.export.notebook import audit_text

        return audit_text(self)

    def _repr_html_(self) -> str:
        from istc_replay.export.notebook import audit_notebook

        return audit_notebook(self)

    def _repr_mimebundle_(self, include: Any = None, exclude: Any = None) -> dict[str, str]:
        return _wanted({"text/plain": repr(self), "text/html": self._repr_html_()}, include, exclude)


@dataclass(frozen=True, slots=True, repr=False)
class ShownComparison(Comparison):
    """A comparison, with its looks: sentences in a console, tables in a notebook."""

    def __repr__(self) -> str:
        return "\n".join(visible(text) for text in sentences(self))

    def _repr_html_(self) -> str:
        from istc_replay.export.notebook import comparison_notebook

        return comparison_notebook(self)

    def _repr_mimebundle_(self, include: Any = None, exclude: Any = None) -> dict[str, str]:
        return _wanted({"text/plain": repr(self), "text/html": self._repr_html_()}, include, exclude)


def shown_result(result: Result) -> ShownResult:
    """The same result, with its looks."""
    return ShownResult(*(getattr(result, field.name) for field in fields(Result)))


def shown_audit(audit: Audit) -> ShownAudit:
    """The same audit, with its looks."""
    return ShownAudit(*(getattr(audit, field.name) for field in fields(Audit)))


def shown_comparison(comparison: Comparison) -> ShownComparison:
    """The same comparison, with its looks."""
    return ShownComparison(*(getattr(comparison, field.name) for field in fields(Comparison)))


def _wanted(bundle: dict[str, str], include: Any, exclude: Any) -> dict[str, str]:
    kept = set(include or bundle) - set(exclude or ())
    return {kind: content for kind, content in bundle.items() if kind in kept}
