"""Inflating within bounds: bombs, lies about lengths, and checksums."""

from __future__ import annotations

import tracemalloc
import zlib
from collections.abc import Callable

import lz4.frame
import pytest
import zstandard

from istc_replay.ingest.inflate import InflateError, Inflater
from istc_replay.ingest.problems import Problems
from istc_replay.ingest.records import ChunkHead

ZEROS = bytes(2**20)


def zstd(mebibytes: int) -> bytes:
    compressor = zstandard.ZstdCompressor().compressobj()
    return b"".join(compressor.compress(ZEROS) for _ in range(mebibytes)) + compressor.flush()


def lz4_frame(mebibytes: int) -> bytes:
    compressor = lz4.frame.LZ4FrameCompressor()
    parts = [compressor.begin(), *(compressor.compress(ZEROS) for _ in range(mebibytes)), compressor.flush()]
    return b"".join(parts)


COMPRESS = {"zstd": zstd, "lz4": lz4_frame, "": bytes}


def head(data: bytes, size: int, compression: str, crc: int = 0) -> ChunkHead:
    return ChunkHead(size, crc, compression, 0, len(data))


@pytest.mark.parametrize("claim", [0, 1000, 2**20, 2**28 + 1, 2**63])
@pytest.mark.parametrize(("compression", "bomb"), [("zstd", zstd), ("lz4", lz4_frame)])
def test_a_bomb_takes_no_more_memory_than_it_claims(
    compression: str, bomb: Callable[[int], bytes], claim: int
) -> None:
    data = bomb(200)
    tracemalloc.start()
    with pytest.raises(InflateError):
        Inflater(2**30, Problems()).records(data, head(data, claim, compression), 0)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 16 * 2**20


def test_many_chunks_together_inflate_to_no_more_than_their_file_may_hold() -> None:
    bomb = zstd(20)
    inflater = Inflater(len(bomb), Problems())
    assert len(inflater.records(bomb, head(bomb, 20 * 2**20, "zstd"), 0)) == 20 * 2**20
    with pytest.raises(InflateError) as error:
        inflater.records(bomb, head(bomb, 20 * 2**20, "zstd"), 0)
    assert error.value.code == "inflation_limit"


@pytest.mark.parametrize("compression", COMPRESS)
def test_what_was_compressed_comes_back(compression: str) -> None:
    content = bytes(range(256)) * 50
    packed = {"zstd": zstandard.compress, "lz4": lz4.frame.compress, "": bytes}[compression](content)
    crc = zlib.crc32(content)
    problems = Problems()
    chunk = head(packed, len(content), compression, crc)
    assert Inflater(len(packed), problems).records(packed, chunk, 0) == content
    assert problems.found() == ()


@pytest.mark.parametrize("compression", COMPRESS)
def test_a_checksum_that_does_not_hold_refuses_the_chunk(compression: str) -> None:
    packed = COMPRESS[compression](1) if compression else ZEROS
    with pytest.raises(InflateError) as error:
        Inflater(len(packed), Problems()).records(packed, head(packed, 2**20, compression, crc=1), 0)
    assert error.value.code == "chunk_crc"


def test_a_wrong_length_is_forgiven_where_the_checksum_holds() -> None:
    content = b"sound records"
    problems = Problems()
    crc = zlib.crc32(content)
    assert Inflater(99, problems).records(content, head(content, 50, "", crc), 7) == content
    assert [(problem.code, problem.offset) for problem in problems.found()] == [("chunk_size", 7)]
    for size in (50, 5):
        with pytest.raises(InflateError) as error:
            Inflater(99, problems).records(content, head(content, size, ""), 0)
        assert error.value.code == "chunk_damaged"


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_damaged_data_are_refused(compression: str) -> None:
    packed = COMPRESS[compression](1)
    for damaged in (b"", b"noise", packed[: len(packed) // 2], b"\0" + packed[1:]):
        with pytest.raises(InflateError) as error:
            Inflater(99, Problems()).records(damaged, head(damaged, 2**20, compression), 0)
        assert error.value.code == "chunk_damaged"


def test_an_unknown_compression_is_named() -> None:
    with pytest.raises(InflateError, match="brotli") as error:
        Inflater(99, Problems()).records(b"x", head(b"x", 1, "brotli"), 0)
    assert error.value.code == "unknown_compression"
