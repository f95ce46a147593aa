"""Inflating chunks within bounds: no chunk can exhaust memory, whatever it claims or holds."""

from __future__ import annotations

import io

import lz4.frame
import zstandard

#: The longest chunk that is inflated [bytes].
CHUNK_LIMIT = 256 * 2**20

_WINDOW_LIMIT = 128 * 2**20


class InflateError(ValueError):
    """A chunk cannot be inflated; `code` is the problem's."""

    def __init__(self, code: str, detail: str) -> None:
        super().__init__(detail)
        self.code = code


def inflate(compression: str, data: bytes, size: int) -> bytes:
    """Inflate a chunk's records.

    Parameters
    ----------
    compression : str
        `zstd`, `lz4` or empty.
    data : bytes
        The compressed records.
    size : int
        Their declared length when inflated [bytes], at most CHUNK_LIMIT.

    Returns
    -------
    bytes
        At most size + 1 bytes: more than size means that the declared length is too small.

    Raises
    ------
    InflateError
        If the compression is unknown or the data are damaged.
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
        raise InflateError(
            "chunk_damaged", f"a {compression} chunk that cannot be inflated: {error}"
        ) from None
    raise InflateError(
        "unknown_compression", f"a chunk compressed by {compression!r}; known: zstd, lz4 and none"
    )
