"""The seeds of scripts/fuzz, what it has found among them: each is read, or refused in a line."""

from __future__ import annotations

from pathlib import Path

import pytest

from istc_replay.config import Config
from istc_replay.errors import LogError
from istc_replay.ingest.log import read_log
from istc_replay.pipeline.convert import convert_recording
from istc_replay.pipeline.recover import recover_log

CORPUS = Path(__file__).resolve().parents[1] / "data/fuzz"
#: The first byte of a recording chooses its name.
SUFFIXES = (".xml", ".csv", ".parquet", ".xml.gz")


@pytest.mark.parametrize("seed", sorted((CORPUS / "recordings").iterdir()), ids=lambda path: path.name)
def test_a_recording_is_converted_or_refused_in_a_line(seed: Path, tmp_path: Path) -> None:
    data, out = seed.read_bytes(), tmp_path / "out.mcap"
    source = tmp_path / f"in{SUFFIXES[data[0] % 4]}"
    source.write_bytes(data[1:])
    if seed.name.startswith("damaged"):
        with pytest.raises(LogError) as error:
            convert_recording(source, out, Config())
        assert "\n" not in str(error.value)
        assert not out.exists()
        return
    assert convert_recording(source, out, Config()).states > 0
    assert read_log(out).complete


@pytest.mark.parametrize("seed", sorted((CORPUS / "log").iterdir()), ids=lambda path: path.name)
def test_a_log_is_recovered_whole(seed: Path, tmp_path: Path) -> None:
    copied = recover_log(seed, tmp_path / "out.mcap")
    assert copied.complete
    assert read_log(tmp_path / "out.mcap").messages == read_log(seed).messages == copied.messages
