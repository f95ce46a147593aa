"""What is wrong with one payload, and how long one may be."""

from __future__ import annotations

#: Longest payload that is decoded [bytes].
PAYLOAD_LIMIT = 4 * 2**20


class PayloadError(ValueError):
    """A payload or a schema cannot be decoded; `code` is the problem's."""

    def __init__(self, detail: str, code: str = "payload") -> None:
        super().__init__(detail)
        self.code = code
