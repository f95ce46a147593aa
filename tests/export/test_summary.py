"""summary.json: what it is written as."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from istc_replay.export.summary import summary_text

values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=12,
)


@settings(deadline=None)
@given(st.dictionaries(st.text(), values, max_size=5))
def test_it_is_json_of_the_same_values(summary: dict[str, Any]) -> None:
    assert json.loads("".join(summary_text(summary))) == summary


def test_windows_and_solves_stand_on_a_line_each() -> None:
    windows = [{"index": k, "vehicles": [{"id": "a\nb"}]} for k in range(3)]
    text = "".join(summary_text({"schema": "s", "windows": windows, "totals": {"windows": 3}}))
    assert [json.loads(line.rstrip(",")) for line in text.splitlines() if '"index"' in line] == windows


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_what_is_not_finite_is_refused(value: float) -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        list(summary_text({"windows": [{"gap": value}]}))
