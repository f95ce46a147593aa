"""Inflating chunks within bounds: no chunk can exhaust memory or time, whatever it claims or holds."""

from __future__ import annotations

import io
import zlib

import lz4.frame
import zstandard

from istc_replay.ingest.problems import Problems
from istc_replay.ingest.records import Buffer, ChunkHead

#: The longest chunk that is inflated [bytes].
CHUNK_LIMIT = 256 * 2**20

#: What all chunks together may inflate to: so many bytes, and so many for each byte of the file.
_TOTAL_FLOOR = 32 * 2**20
_TOTAL_RATIO = 100
_WINDOW_LIMIT = 128 * 2**20


class InflateError(ValueError):
    """A chunk's records cannot be had; `code` is the problem's."""

    def __init__(self, code: str, detail: str) -> None:
        super().__init__(detail)
        self.code = code


class Inflater:
    """Inflates the chunks of one file of file_size bytes."""

    def __init__(self, file_size: int, problems: Problems) -> None:
        self._left = _TOTAL_FLOOR + _TOTAL_RATIO * file_size
        self._problems = problems

    def records(self, buffer: Buffer, chunk: ChunkHead, offset: int) -> bytes:
        """Inflate the records of a chunk whose record stands at offset, and check them.

        Raises
        ------
        InflateError
            If the chunk is above a limit, is compressed in an unknown way, is damaged, or does not
            match its checksum.
        """
        size, longest = chunk.uncompressed_size, max(chunk.uncompressed_size, chunk.size)
        if longest > CHUNK_LIMIT:
            raise InflateError(
                "chunk_too_long", f"a chunk of {longest} bytes, above the limit of {CHUNK_LIMIT}"
            )
        if size > self._left:
            raise InflateError(
                "inflation_limit", "the chunks inflate to more than a file of this size may hold"
            )
        data = inflate(chunk.compression, buffer[chunk.start : chunk.start + chunk.size], size)
        self._left -= len(data)
        sound = zlib.crc32(data) == chunk.crc
        if len(data) != size:
            detail = f"a chunk of {size} bytes holds {'more' if len(data) > size else len(data)}"
            if not (chunk.crc and sound):
                raise InflateError("chunk_damaged", detail)
            self._problems.add("chunk_size", f"{detail}, but its checksum holds", offset)
        if chunk.crc and not sound:
            raise InflateError("chunk_crc", f"a chunk of {size} bytes does not match its checksum")
        return data


def inflate(compression: str, data: bytes, size: int) -> bytes:
    """Inflate data to at most size + 1 bytes: more than size means that size was too small.

    Raises
    ------
    InflateError
        If the compression is none of `zstd`, `lz4` and the empty string, or the data are damaged.
    """
    # Readers that stop at the limit: what lies beyond it is never inflated.
    limit = size + 1
    try:
        if compression == "":
            return data[:limit]
        if compression == "zstd":
            decompressor = zstandard.ZstdDecompressor(max_window_size=_WINDOW_LIMIT)
            with decompressor.stream_reader(data, read_across_frames=True) as reader:
                return bytes(reader.read(limit))
        if compression == "lz4":
            with lz4.frame.LZ4FrameFile(io.BytesIO(data)) as reader:
                return bytes(reader.read(limit))
    except (zstandard.ZstdError, RuntimeError, EOFError, OSError, ValueError, MemoryError) as error:
        reason = " ".join(str(error).split())
        raise InflateError("chunk_damaged", f"{compression} cannot inflate a chunk: {reason}") from None
    raise InflateError(
        "unknown_compression", f"compression {compression[:40]!r} is none of zstd, lz4 and none"
    )
