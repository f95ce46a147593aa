"""Two results in one recording: each whole under its own root, every view with content."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from rerun.chunk import Chunk

from istc_replay.comparison.compare import compare_results
from istc_replay.config import ViewConfig
from istc_replay.datatypes import Result
from istc_replay.export.rerun.beside import beside_blueprint, beside_chunks, write_beside
from istc_replay.export.rerun.view import view_chunks


def flat(parts: Iterable[list[Chunk]]) -> list[Chunk]:
    return list(itertools.chain.from_iterable(parts))


def test_each_side_holds_what_its_view_holds(
    synthetic_result: Result, moved_result: Callable[[Result], Result], strict_rerun: None
) -> None:
    other = moved_result(synthetic_result)
    chunks = flat(beside_chunks(compare_results(synthetic_result, other), synthetic_result, other))
    own = sorted((chunk.entity_path, chunk.num_rows) for chunk in view_chunks(synthetic_result, ViewConfig()))
    for side in ("/a", "/b"):
        held = [(c.entity_path, c.num_rows) for c in chunks if c.entity_path.startswith(f"{side}/")]
        assert sorted((path.removeprefix(side), rows) for path, rows in held) == own
    assert [c.entity_path for c in chunks if c.entity_path[:3] not in ("/a/", "/b/")] == ["/difference"]


def test_every_view_of_the_layout_has_content(synthetic_result: Result, strict_rerun: None) -> None:
    comparison = compare_results(synthetic_result, synthetic_result)
    paths = {
        chunk.entity_path for chunk in flat(beside_chunks(comparison, synthetic_result, synthetic_result))
    }

    def views(part: Any) -> list[Any]:
        inner = getattr(part, "contents", None) or []
        found = [part] if hasattr(part, "origin") else []
        return found + [view for child in inner if not isinstance(child, str) for view in views(child)]

    shown = views(beside_blueprint().root_container)
    assert len(shown) == 11
    for view in shown:
        for query in view.contents:
            root = query.removesuffix("/**")
            assert any(path == root or path.startswith(f"{root}/") for path in paths), (view.name, query)


def test_names_stay_text_in_the_words(
    hostile_result: Result, moved_result: Callable[[Result], Result], tmp_path: Path
) -> None:
    other = moved_result(hostile_result)
    comparison = compare_results(hostile_result, other)
    words = next(
        chunk
        for chunk in flat(beside_chunks(comparison, hostile_result, other))
        if chunk.entity_path == "/difference"
    )
    text = str(words.to_record_batch().to_pydict())
    assert "<script>" not in text
    assert "1 window differs" in text.replace("\\", "")
    write_beside(comparison, replace(hostile_result, config_toml=""), other, tmp_path / "compare.rrd")
    assert (tmp_path / "compare.rrd").stat().st_size > 10_000
