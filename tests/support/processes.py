"""What a process and its children do."""

from __future__ import annotations

import psutil


def listening(pid: int) -> set[str]:
    """The addresses on which a process and its children listen; there must be one at least."""
    process = psutil.Process(pid)
    found = {
        connection.laddr.ip
        for one in (process, *process.children(recursive=True))
        for connection in one.net_connections(kind="inet")
        if connection.status == psutil.CONN_LISTEN
    }
    assert found
    return found
