"""Bytes that are hashed while they are written."""

from __future__ import annotations

import hashlib
from typing import BinaryIO


class HashedFile:
    """A binary file to write to, once from its start to its end.

    Parameters
    ----------
    file : binary file
        Where the bytes go.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._hash = hashlib.sha256()

    @property
    def sha256(self) -> str:
        """Hash of what is written so far; hexadecimal."""
        return self._hash.hexdigest()

    def write(self, data: bytes | bytearray | memoryview) -> int:
        """Write bytes."""
        self._hash.update(data)
        return self._file.write(data)

    def tell(self) -> int:
        """Bytes written."""
        return self._file.tell()

    def flush(self) -> None:
        """Hand over what is written."""
        self._file.flush()
