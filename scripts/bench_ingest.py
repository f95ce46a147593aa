"""Reading logs, side by side: mcap with decoders into Polars, read_log, and the walk alone.

Every route runs in a process of its own, on the same file, after a run on a small one. Seconds are
those of the processor,
all threads together, without imports; memory is the process's peak.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import polars as pl
from google.protobuf import descriptor_pb2
from mcap.reader import make_reader
from mcap.writer import Writer

from istc_replay.config import parse_config
from istc_replay.export import sample_osi
from istc_replay.ingest.log import read_log
from istc_replay.ingest.odometry import DEFINITION
from istc_replay.ingest.walk import open_log

T0_NS = 1_700_000_000_000_000_000
VEHICLES = 20
OBJECTS = 10
CONFIG = """
[ingest]
odometry_reference_point = "box_centre"
[ingest.topics."/states".fields]
vehicle_id = "id"
time = "timestamp"
x_m = "x"
y_m = "y"
heading_rad = "yaw"
speed_mps = "v"
acceleration_mps2 = "a"
length_m = "length"
width_m = "width"
"""
COLUMNS = ("vehicle_id", "time_ns", "x_m", "y_m", "heading_rad", "speed_mps")
MORE = ("acceleration_mps2", "length_m", "width_m")
#: All that the messages tell, by both routes.
TOLD = {
    "Odometry": COLUMNS,
    "JSON": (*COLUMNS, *MORE),
    "OSI": (*COLUMNS, *MORE, "rear_axle_to_centre_m", "role"),
}


def motion(k: int, vehicle: int) -> tuple[int, float, float, float, float]:
    """Time, x, y, yaw and speed of a vehicle on a circle at its k-th state."""
    turn = 0.01 * k + vehicle
    radius = 20.0 + vehicle
    yaw = math.remainder(turn + math.pi / 2, math.tau)
    return T0_NS + k * 100_000_000, radius * math.cos(turn), radius * math.sin(turn), yaw, radius * 0.1


# --- the logs ------------------------------------------------------------------------------------


def odometry(writer: Writer, messages: int) -> None:
    definition = DEFINITION.replace(b"\n===\n", b"\n" + b"=" * 80 + b"\n")
    schema = writer.register_schema("nav_msgs/msg/Odometry", "ros2msg", definition)
    channels = [writer.register_channel(f"/car_{v:02}/odom", "cdr", schema) for v in range(VEHICLES)]
    for index in range(messages):
        k, vehicle = divmod(index, VEHICLES)
        time_ns, x, y, yaw, speed = motion(k, vehicle)
        head = struct.pack("<4siII4s", b"\0\1\0\0", time_ns // 10**9, time_ns % 10**9, 4, b"map\0")
        child = f"car_{vehicle:02}/base_link\0".encode()
        head += struct.pack("<I", len(child)) + child
        head += bytes(-(len(head) - 4) % 8)
        pose = struct.pack("<7d", x, y, 0.0, 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
        twist = struct.pack("<6d", speed, 0.0, 0.0, 0.0, 0.0, 0.1)
        data = head + pose + struct.pack("<36d", *[0.01] * 36) + twist + struct.pack("<36d", *[0.02] * 36)
        writer.add_message(channels[vehicle], time_ns, data, time_ns, k)


def osi(writer: Writer, messages: int) -> None:
    files = descriptor_pb2.FileDescriptorSet(file=[sample_osi._file()])
    schema = writer.register_schema("osi3.GroundTruth", "protobuf", files.SerializeToString())
    channel = writer.register_channel("ground_truth", "protobuf", schema)
    kind = sample_osi._ground_truth_class()
    for k in range(messages // OBJECTS):
        truth = kind()
        for vehicle in range(OBJECTS):
            time_ns, x, y, yaw, speed = motion(k, vehicle)
            moving = truth.moving_object.add()
            moving.id.value, moving.type = 100 + vehicle, 2
            base = moving.base
            base.position.x, base.position.y, base.position.z = x, y, 0.75
            base.orientation.yaw, base.orientation.pitch, base.orientation.roll = yaw, 0.001, 0.002
            base.velocity.x, base.velocity.y = speed * math.cos(yaw), speed * math.sin(yaw)
            base.acceleration.x, base.acceleration.y = 0.1 * math.cos(yaw), 0.1 * math.sin(yaw)
            base.dimension.length, base.dimension.width, base.dimension.height = 4.6, 1.9, 1.5
            moving.vehicle_attributes.bbcenter_to_rear.x = -1.35
            moving.vehicle_classification.type = 4
        truth.timestamp.seconds, truth.timestamp.nanos = divmod(time_ns, 10**9)
        writer.add_message(channel, time_ns, truth.SerializeToString(), time_ns, k)


def json_text(writer: Writer, messages: int) -> None:
    channel = writer.register_channel("/states", "json", 0)
    for index in range(messages):
        k, vehicle = divmod(index, VEHICLES)
        time_ns, x, y, yaw, speed = motion(k, vehicle)
        stamp = {"sec": time_ns // 10**9, "nsec": time_ns % 10**9}
        value = {"timestamp": stamp, "id": str(vehicle), "frame_id": "map", "x": x, "y": y, "yaw": yaw}
        value |= {"v": speed, "a": 0.1, "length": 4.6, "width": 1.9}
        writer.add_message(channel, time_ns, json.dumps(value).encode(), time_ns, k)


WRITERS = {"Odometry": odometry, "OSI": osi, "JSON": json_text}
FLOORS = {"Odometry": 20, "OSI": 6, "JSON": 6}


# --- the routes ----------------------------------------------------------------------------------


def decoded_rows(path: Path, kind: str) -> Iterator[tuple[Any, ...]]:
    """Rows as the mcap library's decoders give them."""
    if kind == "JSON":
        with path.open("rb") as stream:
            for _, _, message in make_reader(stream).iter_messages():
                v = json.loads(message.data)
                time_ns = v["timestamp"]["sec"] * 10**9 + v["timestamp"]["nsec"]
                yield v["id"], time_ns, v["x"], v["y"], v["yaw"], v["v"], v["a"], v["length"], v["width"]
        return
    if kind == "Odometry":
        from mcap_ros2.decoder import DecoderFactory
    else:
        from mcap_protobuf.decoder import DecoderFactory
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, _, _, m in reader.iter_decoded_messages():
            if kind == "Odometry":
                pose, q = m.pose.pose.position, m.pose.pose.orientation
                yaw = math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z))
                time_ns = m.header.stamp.sec * 10**9 + m.header.stamp.nanosec
                yield m.child_frame_id.split("/")[0], time_ns, pose.x, pose.y, yaw, m.twist.twist.linear.x
                continue
            time_ns = m.timestamp.seconds * 10**9 + m.timestamp.nanos
            for moving in m.moving_object:
                base = moving.base
                yaw, velocity = base.orientation.yaw, base.velocity
                along, across, size = math.cos(yaw), math.sin(yaw), base.dimension
                speed = velocity.x * along + velocity.y * across
                acceleration = base.acceleration.x * along + base.acceleration.y * across
                rear = -moving.vehicle_attributes.bbcenter_to_rear.x
                role = "vehicle" if moving.type == 2 and moving.vehicle_classification.type != 9 else "other"
                place = (base.position.x, base.position.y, yaw, speed, acceleration)
                yield str(moving.id.value), time_ns, *place, size.length, size.width, rear, role


def by_decoders(path: Path, kind: str) -> pl.DataFrame:
    columns = list(zip(*decoded_rows(path, kind), strict=True))
    return pl.DataFrame(dict(zip(TOLD[kind], columns, strict=True))).sort("vehicle_id", "time_ns")


def by_read_log(path: Path, kind: str) -> pl.DataFrame:
    return read_log(path, parse_config(CONFIG)).states.select(TOLD[kind])


def by_walk(path: Path, _kind: str) -> None:
    for _ in open_log(path).batches():
        pass


ROUTES = {"mcap + decoders": by_decoders, "read_log": by_read_log, "walk alone": by_walk}


def peak_mib() -> float:
    """Most memory that this process has held; its files that are mapped count as well."""
    status = Path("/proc/self/status")
    if status.exists():  # getrusage would count what the parent held
        line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
        return int(line.split()[1]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def run_route(path: Path, kind: str, route: str) -> None:
    """Run one route and print its figures; called in a process of its own."""
    # The first call of a library loads and starts what is no part of reading.
    ROUTES[route](path.with_suffix(".small.mcap"), kind)
    before = time.process_time()
    table = ROUTES[route](path, kind)
    seconds = time.process_time() - before
    peak = peak_mib()
    if table is not None:
        table.write_parquet(path.with_suffix(f".{route.split()[0]}.parquet"))
    print(json.dumps({"seconds": seconds, "peak_mib": peak}))


# --- the table -----------------------------------------------------------------------------------


def measure(path: Path, kind: str, route: str) -> dict[str, float]:
    command = [sys.executable, __file__, "--route", route, "--kind", kind, "--path", str(path)]
    best: dict[str, float] = {}
    for _ in range(1 if route == "mcap + decoders" else 3):
        done = subprocess.run(command, capture_output=True, text=True, check=True)  # noqa: S603
        figures = json.loads(done.stdout)
        if not best or figures["seconds"] < best["seconds"]:
            best = figures
    return best


def difference(path: Path, kind: str) -> float:
    """Largest difference of a number between the two tables; inf where anything else differs."""
    ours, theirs = (pl.read_parquet(path.with_suffix(f".{name}.parquet")) for name in ("read_log", "mcap"))
    keys = [name for name in TOLD[kind] if name in ("vehicle_id", "time_ns", "role")]
    if not ours.select(keys).equals(theirs.select(keys)):
        return math.inf
    turn = (ours["heading_rad"] - theirs["heading_rad"]).to_numpy()
    worst = max(abs(math.remainder(value, math.tau)) for value in turn)
    numbers = (name for name in TOLD[kind] if name not in (*keys, "heading_rad"))
    return max([worst] + [(ours[name] - theirs[name]).abs().max() for name in numbers])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--messages", type=int, default=100_000, help="messages of Odometry and JSON")
    parser.add_argument("--osi-states", type=int, default=100_000, help="states of OSI, 10 a message")
    parser.add_argument("--route", help=argparse.SUPPRESS)
    parser.add_argument("--kind", help=argparse.SUPPRESS)
    parser.add_argument("--path", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.route:
        run_route(options.path, options.kind, options.route)
        return 0
    print("| log | raw MiB | route | seconds | MiB/s | ratio | peak MiB | largest difference |")
    print("|---|---|---|---|---|---|---|---|")
    missed = []
    with tempfile.TemporaryDirectory() as folder:
        for kind, write in WRITERS.items():
            path = Path(folder) / f"{kind}.mcap"
            count = options.osi_states if kind == "OSI" else options.messages
            for file, size in ((path, count), (path.with_suffix(".small.mcap"), 1000)):
                with file.open("wb") as stream:
                    writer = Writer(stream)
                    writer.start()
                    write(writer, size)
                    writer.finish()
            raw = sum(int((b.ends - b.starts).sum()) for b in open_log(path).batches()) / 2**20
            figures = {route: measure(path, kind, route) for route in ROUTES}
            slow = figures["mcap + decoders"]["seconds"]
            for route, found in figures.items():
                ratio, speed = slow / found["seconds"], raw / found["seconds"]
                same = f"{difference(path, kind):.1e}" if route == "read_log" else ""
                name = f"{kind}, {count} {'states' if kind == 'OSI' else 'messages'}"
                print(
                    f"| {name} | {raw:.0f} | {route} | {found['seconds']:.3f} | {speed:.0f} | {ratio:.1f} |"
                    f" {found['peak_mib']:.0f} | {same} |",
                    flush=True,
                )
                if route == "read_log" and (ratio < FLOORS[kind] or not float(same) < 1e-9):
                    missed.append(f"{kind}: {ratio:.1f} times, at least {FLOORS[kind]} wanted")
    if missed:
        print("; ".join(missed), file=sys.stderr)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
