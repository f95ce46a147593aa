"""The notebook in docs, run by a real kernel."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOK = ROOT / "docs" / "notebook.ipynb"


@pytest.fixture(scope="module")
def executed() -> Any:
    """The notebook with the outputs of a fresh run."""
    nbformat = pytest.importorskip("nbformat", reason="nbformat is not installed")
    nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed")
    pytest.importorskip("ipykernel", reason="ipykernel is not installed")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    client = nbclient.NotebookClient(
        notebook, timeout=300, kernel_name="python3", resources={"metadata": {"path": str(NOTEBOOK.parent)}}
    )
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (str(ROOT), before)))
    try:
        client.execute()
    finally:
        os.environ.pop("PYTHONPATH")
        if before is not None:
            os.environ["PYTHONPATH"] = before
    return notebook


def shown(executed: Any, source: str, kind: str) -> str:
    """The output of the cell that ends with a source."""
    (cell,) = [cell for cell in executed.cells if cell.source.endswith(source)]
    (output,) = [output for output in cell.outputs if output.output_type == "execute_result"]
    return str(output.data[kind])


def test_it_is_kept_without_outputs() -> None:
    nbformat = pytest.importorskip("nbformat", reason="nbformat is not installed")
    for cell in nbformat.read(NOTEBOOK, as_version=4).cells:
        assert not cell.get("outputs")
        assert cell.get("execution_count") is None


def test_a_result_an_audit_and_a_comparison_show_themselves(executed: Any) -> None:
    result = shown(executed, "\nresult", "text/html")
    assert "3 of 3 plannable vehicles certified" in result
    assert result.count("<img") == 2
    assert "critical" in shown(executed, "istc_replay.audit(result)", "text/html")
    comparison = shown(executed, "istc_replay.compare(result, other)", "text/html")
    assert "What moved" in comparison
    assert "waits for" in comparison
    assert shown(executed, "\nresult", "text/plain").startswith("Result of intersection_turn_first.mcap")


def test_nothing_is_printed_to_stderr(executed: Any) -> None:
    streams = [output for cell in executed.cells for output in cell.get("outputs", ()) if "name" in output]
    assert not [output.text for output in streams if output.name == "stderr"]


def test_pictures_are_pictures(executed: Any) -> None:
    assert len(shown(executed, '"png"))', "image/png")) > 10_000
