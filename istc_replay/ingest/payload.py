"""What is wrong with one payload, and how long one may be."""

from __future__ import annotations

#: Longest payload that is decoded [bytes].
PAYLOAD_LIMIT = 4 * 2**20


class PayloadError(ValueError):
    """A payload or a schema cannot be decoded; `code` is the problem's."""

    def __init__(self, detail: str, code: str = "payload") -> None:
        super().__init__(detail)
        self.code = code


class TooMuchError(PayloadError):
    """A payload holds more than is decoded, in whatever way it were written."""


class TooManyItemsError(Exception):
    """Several payloads hold more items than are decoded at once; `rows` of them may be few enough."""

    def __init__(self, rows: int) -> None:
        super().__init__()
        self.rows = rows


#: Items of several payloads that are decoded at once.
ITEMS_AT_ONCE = 100_000
#: Fields that are parsed one by one in a file, beside one for each of its bytes.
_FIELDS_FLOOR = 600_000


class Budget:
    """What may be parsed field by field in one file: a small one cannot ask for much work."""

    def __init__(self, file_size: int) -> None:
        self._left = _FIELDS_FLOOR + file_size

    @property
    def any_left(self) -> bool:
        """Whether more may be parsed."""
        return self._left > 0

    def check(self) -> None:
        """Refuse to parse where nothing is left.

        Raises
        ------
        TooMuchError
            If there is not.
        """
        if not self.any_left:
            raise TooMuchError("the payloads have more fields than a file of this size may hold")

    def spend(self, fields: int) -> None:
        """Note fields that were parsed."""
        self._left -= fields
