"""Coverage-guided fuzzing of everything that reads bytes, for a bounded time.

Needs atheris (`pip install atheris`). Each target feeds mutated inputs to a reader and fails on any
exception that is not the project's own, on more than 2 s or 500 MiB for one input, and where what was
read contradicts the reference library or the copy that `recover` writes. What it finds is kept as
crash-* in the folder of --artifacts.
"""

from __future__ import annotations

import argparse
import io
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

try:
    import atheris
except ImportError:
    print(
        "fuzz: atheris is not installed; `pip install atheris` (Linux, Python 3.11 to 3.13)", file=sys.stderr
    )
    sys.exit(2)

with atheris.instrument_imports(include=["istc_replay.ingest", "istc_replay.pipeline", "istc_replay.export"]):
    from istc_replay.config import Config, parse_config
    from istc_replay.errors import IstcReplayError
    from istc_replay.export import sample_osi
    from istc_replay.ingest.log import read_log
    from istc_replay.ingest.odometry import DEFINITION
    from istc_replay.ingest.walk import open_log
    from istc_replay.messages import descriptor_set
    from istc_replay.pipeline.convert import convert_recording
    from istc_replay.pipeline.recover import recover_log

from google.protobuf import descriptor_pb2
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

ROOT = Path(__file__).resolve().parents[1]
CORPUS = ROOT / "tests/data/fuzz"
MAPPED = parse_config(
    '[ingest.topics."/json"]\nitems = "v"\n[ingest.topics."/json".fields]\n'
    'vehicle_id = "id"\ntime = "/stamp"\nposition = "p"\nheading_rad = "yaw"\nlength_m = "size.0"\n'
)
#: One input's bounds: processor seconds, and memory beyond what the readers take to load [MiB].
LIMIT_S, LIMIT_MIB = 2.0, 500
FOLDER = Path(tempfile.mkdtemp(prefix="istc-fuzz-"))


def scratch(suffix: str) -> Path:
    return FOLDER / f"input{suffix}"


def bounded(job: Callable[[], None]) -> None:
    """Run a job, which may refuse its input but not take long."""
    before = time.process_time()
    try:
        job()
    except IstcReplayError as error:
        if "\n" in str(error) or len(str(error)) > 2000:
            raise AssertionError("an error of more than a line") from error
    taken = time.process_time() - before
    if taken > LIMIT_S:
        raise AssertionError(f"{taken:.1f} s for one input")


def log(data: bytes) -> None:
    """A whole file."""
    path = scratch(".mcap")
    path.write_bytes(data)

    def job() -> None:
        found = read_log(path, MAPPED)
        walk = open_log(path)
        messages = [(m.log_time_ns, m.data) for m in walk.messages()]
        if walk.complete and not walk.problems:
            agree(data, messages)
        out = scratch(".out.mcap")
        recover_log(path, out)
        again = open_log(out)
        copied = [(m.log_time_ns, m.data) for m in again.messages()]
        same(copied, messages)
        same(again.complete, True)
        same(found.messages, walk.message_count)

    bounded(job)


def agree(data: bytes, messages: list[tuple[int, bytes]]) -> None:
    """The reference library reads the same from a file that we find whole."""
    try:
        records = list(StreamReader(io.BytesIO(data)).records)
    except Exception:
        return  # it may refuse what we can read
    same([(r.log_time, r.data) for r in records if type(r).__name__ == "Message"], messages)


def same(found: object, expected: object) -> None:
    """Fail where two readings differ."""
    if found != expected:
        raise AssertionError(f"{str(found)[:200]} and not {str(expected)[:200]}")


def payloads(data: bytes) -> None:
    """Payloads of every encoding, in a file that is whole: the first byte chooses, the next cuts."""
    if len(data) < 3:
        return
    stream = io.BytesIO()
    writer = Writer(stream, compression=CompressionType.NONE, use_chunking=False)
    writer.start()
    osi = descriptor_pb2.FileDescriptorSet(file=[sample_osi._file()]).SerializeToString()
    schemas = (
        ("/osi", "osi3.GroundTruth", "protobuf", osi, "protobuf"),
        ("/state", "istc.v1.VehicleState", "protobuf", descriptor_set(), "protobuf"),
        ("/scene", "istc.v1.Scene", "protobuf", descriptor_set(), "protobuf"),
        ("/odom", "nav_msgs/msg/Odometry", "ros2msg", DEFINITION, "cdr"),
        ("/json", "", "", b"", "json"),
        # The definition itself is the input.
        ("/tf", "tf2_msgs/msg/TFMessage", "ros2msg", data[2:], "cdr"),
        ("/truth", "osi3.GroundTruth", "protobuf", data[2:], "protobuf"),
    )
    topic, name, encoding, definition, message_encoding = schemas[data[0] % len(schemas)]
    schema_id = writer.register_schema(name, encoding, definition) if name else 0
    channel = writer.register_channel(topic, message_encoding, schema_id)
    size = max(data[1], 1)
    for index in range(0, min(len(data) - 2, 64 * size), size):
        writer.add_message(channel, index, data[2 + index : 2 + index + size], index)
    writer.add_message(channel, len(data), data[2:], len(data))
    writer.finish()
    path = scratch(".mcap")
    path.write_bytes(stream.getvalue())
    bounded(lambda: void(read_log(path, MAPPED)))


def recordings(data: bytes) -> None:
    """Other formats: the first byte chooses the name."""
    if not data:
        return
    path = scratch((".xml", ".csv", ".parquet", ".xml.gz")[data[0] % 4])
    path.write_bytes(data[1:])
    bounded(lambda: void(convert_recording(path, scratch(".out.mcap"), Config())))


def void(_: object) -> None:
    """Drop a value."""


TARGETS: dict[str, Callable[[bytes], None]] = {"log": log, "payloads": payloads, "recordings": recordings}


def run_one(target: str, seconds: int, artifacts: Path) -> int:
    """Fuzz one target in this process; does not return."""
    seeds = CORPUS / target
    work = Path(tempfile.mkdtemp(prefix=f"istc-fuzz-{target}-"))
    arguments = [
        sys.argv[0],
        str(work),
        str(seeds),
        f"-max_total_time={seconds}",
        f"-artifact_prefix={artifacts}/{target}-",
        f"-rss_limit_mb={LIMIT_MIB + 400}",
        "-timeout=10",
        "-max_len=8192",
        "-print_final_stats=1",
    ]
    atheris.Setup(arguments, TARGETS[target])
    atheris.Fuzz()
    return 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=int, default=60, help="for each target")
    parser.add_argument("--target", choices=TARGETS, help="one target alone")
    parser.add_argument(
        "--artifacts", type=Path, default=Path("fuzz-artifacts"), help="where findings are kept"
    )
    parser.add_argument("--here", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    options.artifacts.mkdir(parents=True, exist_ok=True)
    if options.here:
        return run_one(options.target, options.seconds, options.artifacts)
    failed = []
    for target in [options.target] if options.target else TARGETS:
        command = [sys.executable, __file__, "--here", "--target", target]
        command += ["--seconds", str(options.seconds), "--artifacts", str(options.artifacts)]
        done = subprocess.run(  # noqa: S603
            command, check=False, capture_output=True, text=True, env={**os.environ, "OMP_NUM_THREADS": "1"}
        )
        lines = done.stderr.splitlines()
        stats = [
            line for line in lines if line.startswith(("stat::number_of_executed_units", "stat::peak_rss"))
        ]
        print(
            f"{target}: exit {done.returncode}; " + "; ".join(line.removeprefix("stat::") for line in stats)
        )
        if done.returncode:
            failed.append(target)
            print("\n".join(lines[-30:]), file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
