"""Faults of the processes that do jobs, by the name of the log that they open; for tests."""

import ctypes
import os
import sys
import time

_held = []


def _fault(event: str, arguments: tuple) -> None:
    if event != "open" or not isinstance(arguments[0], (str, bytes, os.PathLike)):
        return
    name = os.fsdecode(arguments[0]).rsplit(os.sep, 1)[-1]
    if name.startswith("crash"):
        ctypes.string_at(0)  # a true segmentation fault
    elif name.startswith("hang"):
        time.sleep(1e6)
    elif name.startswith("hungry"):
        while True:
            _held.append(bytearray(os.urandom(1 << 20)) * 32)
            time.sleep(0.02)
    elif name.startswith("abort"):
        os.abort()


if "istc_replay.fleet.worker" in " ".join(sys.orig_argv):
    sys.addaudithook(_fault)
