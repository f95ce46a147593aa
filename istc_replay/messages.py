"""The `istc.v1` protobuf messages, built at run time from the compiled descriptors of `schemas/`.

Run-time classes need no generated code, so they never disagree with the installed protobuf.
"""

from __future__ import annotations

from functools import cache
from importlib import resources
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

PACKAGE = "istc.v1"


def descriptor_set() -> bytes:
    """Return the compiled FileDescriptorSet of all `istc.v1` schemas."""
    return resources.files("istc_replay").joinpath("data/istc_v1.binpb").read_bytes()


@cache
def _pool() -> Any:
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(descriptor_set()).file:
        pool.Add(file)
    return pool


@cache
def message(name: str) -> Any:
    """Return the class of the message `istc.v1.<name>`, such as `VehicleState`."""
    return message_factory.GetMessageClass(_pool().FindMessageTypeByName(f"{PACKAGE}.{name}"))
