"""A folder served to this machine's own browser."""

from __future__ import annotations

import io
import os
from functools import partial
from http import HTTPStatus
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import BinaryIO

from istc_replay.errors import ExportError
from istc_replay.export.rerun.viewer import LOCAL


class _Handler(SimpleHTTPRequestHandler):
    """Files of one folder, for pages of this machine alone."""

    extensions_map = {  # noqa: RUF012
        **SimpleHTTPRequestHandler.extensions_map,
        ".css": "text/css; charset=utf-8",
        ".html": "text/html; charset=utf-8",
        ".js": "text/javascript; charset=utf-8",
        ".rrd": "application/octet-stream",
        ".wasm": "application/wasm",
    }

    def send_head(self) -> io.BytesIO | BinaryIO | None:
        # A name that an outsider points at this machine would let his pages read the folder.
        host = self.headers.get("Host", "").rsplit(":", 1)[0]
        if host not in (LOCAL, "localhost"):
            self.send_error(HTTPStatus.FORBIDDEN)
            return None
        return super().send_head()

    def list_directory(self, path: str | os.PathLike[str]) -> io.BytesIO | None:  # noqa: ARG002
        self.send_error(HTTPStatus.NOT_FOUND)
        return None

    def end_headers(self) -> None:
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        super().end_headers()

    def log_message(self, format: str, *_: object) -> None:  # noqa: A002
        """Say nothing: only the command line prints."""


class _Server(ThreadingHTTPServer):
    def handle_error(self, request: object, client_address: object) -> None:
        """Say nothing of a browser that goes away in the middle of an answer."""


def folder_server(folder: Path, port: int = 0) -> ThreadingHTTPServer:
    """A server of a folder that listens on 127.0.0.1 alone, on a free port where it is 0.

    Raises
    ------
    ExportError
        If the port is taken or not allowed.
    """
    try:
        return _Server((LOCAL, port), partial(_Handler, directory=str(folder)))
    except (OSError, OverflowError) as error:
        raise ExportError(f"port {port}: {error}; choose another with --port, or leave it out") from None
