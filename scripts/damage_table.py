"""Damage of every kind: what is recovered, how it is told, in what time and memory.

Each kind is a file made on the spot from one whole log, and `istc-replay info --json` reads it in a
process of its own. The command fails where a message is lost that is intact, where damage is not told,
or where a file takes more than 2 s of the processor or 500 MiB.
"""

from __future__ import annotations

import argparse
import gzip
import io
import json
import os
import struct
import subprocess
import sys
import tempfile
import time
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import lz4.frame
import zstandard
from mcap.writer import CompressionType, Writer

from istc_replay.messages import descriptor_set, message

T0_NS = 1_700_000_000_000_000_000
MAGIC = b"\x89MCAP0\r\n"
MESSAGES, VEHICLES = 2000, 4
LIMIT_S, LIMIT_MIB = 2.0, 500.0


@dataclass(frozen=True)
class Kind:
    """One kind of damage: the file, its intact messages, and the problems that tell it."""

    name: str
    data: Callable[[], bytes]
    intact: int | None  # None: as many as the file says it has; -1: refused as no log
    codes: set[str] = field(default_factory=set)
    fields: dict[str, str] = field(default_factory=dict)  # what /x is read by


# --- records by hand -----------------------------------------------------------------------------


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def text(value: str | bytes) -> bytes:
    raw = value.encode() if isinstance(value, str) else value
    return struct.pack("<I", len(raw)) + raw


def schema(id_: int, name: str, encoding: str, data: bytes) -> bytes:
    return record(0x03, struct.pack("<H", id_) + text(name) + text(encoding) + text(data))


def channel(id_: int, topic: str | bytes, encoding: str, schema_id: int = 0) -> bytes:
    return record(0x04, struct.pack("<HH", id_, schema_id) + text(topic) + text(encoding) + text(b""))


def sample(channel_id: int, data: bytes, time_ns: int = T0_NS) -> bytes:
    return record(0x05, struct.pack("<HIQQ", channel_id, 0, time_ns, time_ns) + data)


def chunk(content: bytes, size: int | None = None, compression: str = "", crc: int | None = None) -> bytes:
    packed = {"zstd": zstandard.compress, "lz4": lz4.frame.compress}.get(compression, bytes)(content)
    crc = zlib.crc32(content) if crc is None else crc
    head = struct.pack("<QQQI", T0_NS, T0_NS, len(content) if size is None else size, crc)
    return record(0x06, head + text(compression) + struct.pack("<Q", len(packed)) + packed)


def file_of(*parts: bytes) -> bytes:
    tail = record(0x0F, bytes(4)) + record(0x02, bytes(20)) + MAGIC
    return MAGIC + record(0x01, text("") + text("damage")) + b"".join(parts) + tail


# --- the whole log -------------------------------------------------------------------------------


def whole(compression: CompressionType = CompressionType.ZSTD, **options: object) -> bytes:
    """A log of four vehicles, 2000 messages, an attachment and a metadata record."""
    stream = io.BytesIO()
    writer = Writer(stream, **{"compression": compression, "chunk_size": 8192, **options})  # type: ignore[arg-type]
    writer.start()
    schema_id = writer.register_schema("istc.v1.VehicleState", "protobuf", descriptor_set())
    channels = [writer.register_channel(f"/car_{v}", "protobuf", schema_id) for v in range(VEHICLES)]
    kind = message("VehicleState")
    for index in range(MESSAGES):
        k, vehicle = divmod(index, VEHICLES)
        time_ns = T0_NS + k * 100_000_000
        state = kind(time_ns=time_ns, vehicle_id=str(vehicle), x_m=0.5 * k, y_m=4.0 * vehicle)
        state.heading_rad, state.speed_mps = 0.0, 5.0
        writer.add_message(channels[vehicle], time_ns, state.SerializeToString(), time_ns, k)
    writer.add_attachment(0, 0, "notes.txt", "text/plain", b"notes" * 100)
    writer.add_metadata("run", {"car": "1"})
    writer.finish()
    return stream.getvalue()


def places(data: bytes, opcode: int) -> list[tuple[int, int]]:
    """Where the records of a kind begin in a whole file, and how long they are."""
    found, position = [], len(MAGIC)
    while position < len(data) - len(MAGIC):
        kind, length = struct.unpack_from("<BQ", data, position)
        if kind == opcode:
            found.append((position, 9 + length))
        position += 9 + length
    return found


def in_chunk(data: bytes, place: int) -> int:
    """Messages of the chunk that begins at a place."""
    size = struct.unpack_from("<Q", data, place + 9 + 16)[0]
    name = struct.unpack_from("<I", data, place + 9 + 28)[0]
    start = place + 9 + 32 + name + 8
    end = place + 9 + struct.unpack_from("<Q", data, place + 1)[0]
    content = zstandard.decompress(data[start:end], max_output_size=size)
    return sum(1 for _ in messages_in(content))


def messages_in(content: bytes) -> list[int]:
    found, position = [], 0
    while position < len(content):
        opcode, length = struct.unpack_from("<BQ", content, position)
        if opcode == 0x05:
            found.append(position)
        position += 9 + length
    return found


def changed(data: bytes, place: int, new: bytes) -> bytes:
    return data[:place] + new + data[place + len(new) :]


WHOLE = whole()
CHUNKS = places(WHOLE, 0x06)
MIDDLE = CHUNKS[len(CHUNKS) // 2]
IN_MIDDLE = in_chunk(WHOLE, MIDDLE[0])
BEFORE_MIDDLE = sum(in_chunk(WHOLE, place) for place, _ in CHUNKS if place < MIDDLE[0])
FOOTER = len(WHOLE) - len(MAGIC) - 29
PLAIN = whole(CompressionType.NONE)
ONE = channel(1, "/x", "json")


def summary_start() -> int:
    return int(struct.unpack_from("<Q", WHOLE, FOOTER + 9)[0])


def statistics_off() -> bytes:
    """A summary that states one message more, and no checksum that would tell."""
    place = places(WHOLE, 0x0B)[0][0]
    data = changed(WHOLE, place + 9, struct.pack("<Q", MESSAGES + 1))
    return changed(data, FOOTER + 25, bytes(4))


def zstd_bomb(size: int) -> bytes:
    packer = zstandard.ZstdCompressor(level=3).compressobj(size=size)
    piece = bytes(2**24)
    packed = b"".join(packer.compress(piece) for _ in range(size // len(piece))) + packer.flush()
    head = struct.pack("<QQQI", 0, 0, size, 0) + text("zstd") + struct.pack("<Q", len(packed))
    return record(0x06, head + packed)


def lying_bomb(compression: str) -> bytes:
    """A chunk that says that it is small and inflates to 64 MiB."""
    return chunk(bytes(2**26), 1000, compression, 0)


def many_bombs() -> bytes:
    """A thousand chunks of 16 MiB each, all within the limit of one."""
    return chunk(bytes(2**24), compression="zstd") * 1000


def nested(levels: int) -> bytes:
    inner = sample(1, b"{}")
    for _ in range(levels):
        inner = chunk(inner, compression="zstd")
    return inner


def osi_dense(items: int, messages: int) -> bytes:
    """OSI messages of many empty objects: two bytes of the file are a state."""
    sys.path.insert(0, str(Path(__file__).resolve().parent))
    from google.protobuf import descriptor_pb2

    from istc_replay.export import sample_osi

    files = descriptor_pb2.FileDescriptorSet(file=[sample_osi._file()]).SerializeToString()
    kind = sample_osi._ground_truth_class()
    truth = kind()
    truth.moving_object.add().id.value = 1
    whole_ = truth.SerializeToString()
    tag = whole_[:1]
    payload = tag + struct.pack("B", len(whole_) - 2) + whole_[2:]
    data = payload + (tag + b"\0") * items
    head = schema(1, "osi3.GroundTruth", "protobuf", files) + channel(1, "/osi", "protobuf", 1)
    return file_of(chunk(head + sample(1, data) * messages, compression="zstd"))


def cdr_dense(messages: int) -> bytes:
    """ROS messages of different sizes, each of many tiny items: a layout each."""
    definition = b"Item[] items\n" + b"=" * 80 + b"\nMSG: pkg/Item\nuint8 id\n"
    head = schema(1, "pkg/msg/Items", "ros2msg", definition) + channel(1, "/x", "cdr", 1)
    body = b"".join(
        sample(1, b"\0\1\0\0" + struct.pack("<I", 9_000 + k) + bytes(9_000 + k)) for k in range(messages)
    )
    return file_of(chunk(head + body, compression="zstd"))


def protobuf_varied(messages: int) -> bytes:
    """States that are each built otherwise: no layout fits a second one."""
    head = schema(1, "istc.v1.VehicleState", "protobuf", descriptor_set()) + channel(1, "/x", "protobuf", 1)
    pieces = []
    for k in range(messages):
        unknown = b"".join(struct.pack("<BBBB", 0xF8, 0x01 + (k >> n & 1), 0x01, k & 1) for n in range(16))
        pieces.append(sample(1, b"\x12\x01a" + unknown * 20))
    return file_of(chunk(head + b"".join(pieces), compression="zstd"))


def json_of(payload: bytes, count: int = 1) -> bytes:
    return file_of(chunk(ONE + sample(1, payload) * count, compression="zstd"))


def channels(count: int) -> bytes:
    """So many channels, of 60 000 ids: ids have 16 bits."""
    body = b"".join(channel(1 + k % 60_000, f"/topic_{k}", "json") for k in range(count))
    return file_of(chunk(body + sample(1, b"{}"), compression="zstd"))


def many_messages() -> bytes:
    """As many messages as a chunk may hold, of a channel that nobody declares."""
    return file_of(chunk(sample(7, b"") * 900_000 + ONE + sample(1, b"{}"), compression="zstd"))


def flipped(place: int) -> bytes:
    return changed(WHOLE, place, bytes([WHOLE[place] ^ 0x40]))


def unknown_in_chunk() -> bytes:
    content = ONE + sample(1, b"{}") + record(0x7F, b"?") + sample(1, b"{}")
    return file_of(chunk(content), record(0x70, b"?"), record(0x81, b"private"))


def cut_message() -> bytes:
    content = ONE + sample(1, b"{}") * 3
    return file_of(chunk(content[:-4]))


def long_message() -> bytes:
    content = ONE + sample(1, b"{}") + changed(sample(1, b"{}"), 1, struct.pack("<Q", 2**40))
    return file_of(chunk(content))


MID = MIDDLE[0]
PLAIN_CHUNK = places(PLAIN, 0x06)[3]
ITEM = {"items": "items", "vehicle_id": "id"}
PLAIN_FIELDS = {"x_m": "x"}


def deep_json() -> bytes:
    return json_of(b'{"x":' * 100_000 + b"1" + b"}" * 100_000)


def same_channel() -> bytes:
    return file_of(chunk(ONE * 1_000_000 + sample(1, b"{}"), compression="zstd"))


def useless() -> bytes:
    return file_of(ONE, sample(1, b"{}"), chunk(record(0x7F, b"") * 3_000_000, compression="zstd"))


def json_dense() -> bytes:
    return json_of(b'{"items":[' + b'{"id":1},' * 19_999 + b"{}]}", 100)


KINDS = (
    Kind("whole", lambda: WHOLE, MESSAGES),
    # Truncation.
    Kind("cut inside a chunk", lambda: WHOLE[: MID + MIDDLE[1] // 2], BEFORE_MIDDLE, {"truncated"}),
    Kind("cut between chunks", lambda: WHOLE[:MID], BEFORE_MIDDLE, {"truncated"}),
    Kind("cut in a record's head", lambda: WHOLE[: MID + 4], BEFORE_MIDDLE, {"truncated"}),
    Kind("cut in the footer", lambda: WHOLE[:-14], MESSAGES, {"truncated"}),
    Kind("cut in the last magic", lambda: WHOLE[:-3], MESSAGES, {"truncated"}),
    Kind("no chunks, cut in a message", lambda: file_of(ONE, sample(1, b"{}") * 9)[:-42], 9, {"truncated"}),
    # Bytes that are not what they were.
    Kind(
        "a flipped byte in a chunk",
        lambda: flipped(MID + MIDDLE[1] - 5),
        MESSAGES - IN_MIDDLE,
        {"statistics"},
    ),
    Kind(
        "a flipped byte in a plain chunk",
        lambda: changed(PLAIN, PLAIN_CHUNK[0] + 500, b"?"),
        None,
        {"chunk_crc"},
    ),
    Kind(
        "a flipped byte in the summary", lambda: flipped(summary_start() + 30), MESSAGES, {"summary_damaged"}
    ),
    Kind(
        "a flipped byte in an attachment",
        lambda: flipped(places(WHOLE, 0x09)[0][0] + 80),
        MESSAGES,
        {"attachment_crc"},
    ),
    Kind("zeros over a kilobyte", lambda: changed(WHOLE, MID + 100, bytes(1024)), None, {"chunk_damaged"}),
    Kind("no magic at the start", lambda: changed(WHOLE, 0, b"\0" * 8), MESSAGES, {"no_magic"}),
    # Checksums.
    Kind("wrong chunk CRC", lambda: file_of(chunk(ONE + sample(1, b"{}"), crc=1)), 0, {"chunk_crc"}),
    Kind(
        "wrong data CRC",
        lambda: file_of(ONE, sample(1, b"{}")).replace(record(0x0F, bytes(4)), record(0x0F, b"\1\2\3\4")),
        1,
        {"data_crc"},
    ),
    Kind(
        "wrong summary CRC", lambda: changed(WHOLE, FOOTER + 25, b"\1\2\3\4"), MESSAGES, {"summary_damaged"}
    ),
    # Lengths and sizes that lie.
    Kind(
        "a record of 2^60 bytes",
        lambda: changed(WHOLE, MID + 1, struct.pack("<Q", 2**60)),
        MESSAGES - IN_MIDDLE,
        {"record_damaged"},
    ),
    Kind(
        "a record that swallows the next",
        lambda: changed(WHOLE, MID + 1, struct.pack("<Q", MIDDLE[1] + 500)),
        MESSAGES,
        {"record_damaged"},
    ),
    Kind(
        "a chunk that says it is smaller",
        lambda: file_of(chunk(ONE + sample(1, b"{}") * 9, 10, crc=0)),
        0,
        {"chunk_damaged"},
    ),
    Kind(
        "a chunk that says it is larger",
        lambda: file_of(chunk(ONE + sample(1, b"{}") * 9, 10**6, "zstd", 0)),
        0,
        {"chunk_damaged"},
    ),
    Kind("a message past its chunk's end", cut_message, 2, {"chunk_damaged"}),
    Kind("a message of 2^40 bytes", long_message, 1, {"chunk_damaged"}),
    Kind(
        "a text of 4 GiB",
        lambda: file_of(record(0x04, bytes(4) + b"\xff" * 8), ONE, sample(1, b"{}")),
        1,
        {"record_damaged"},
    ),
    # Bombs.
    Kind(
        "zstd bomb of 1 GiB", lambda: file_of(ONE, sample(1, b"{}"), zstd_bomb(2**30)), 1, {"chunk_too_long"}
    ),
    Kind(
        "zstd bomb that says it is small",
        lambda: file_of(lying_bomb("zstd"), ONE, sample(1, b"{}")),
        1,
        {"chunk_damaged"},
    ),
    Kind(
        "lz4 bomb that says it is small",
        lambda: file_of(lying_bomb("lz4"), ONE, sample(1, b"{}")),
        1,
        {"chunk_damaged"},
    ),
    Kind(
        "1000 bombs of 16 MiB", lambda: file_of(ONE, sample(1, b"{}"), many_bombs()), 1, {"inflation_limit"}
    ),
    Kind("chunks within chunks", lambda: file_of(nested(50)), 0, {"unexpected_record"}),
    Kind("OSI: 20 000 empty objects a message", lambda: osi_dense(19_000, 400), 400, {"too_many_states"}),
    Kind("OSI: two million empty objects", lambda: osi_dense(2_000_000, 8), 8, {"payload"}),
    Kind("protobuf: 8000 states, each built otherwise", lambda: protobuf_varied(8000), 8000, {"payload"}),
    Kind("CDR: 9000 items a message, 1000 sizes", lambda: cdr_dense(1000), 1000, {"payload"}, ITEM),
    Kind("JSON: 100 000 brackets deep", deep_json, 1, {"payload"}, PLAIN_FIELDS),
    Kind(
        "JSON: a number of a million digits",
        lambda: json_of(b'{"x": 1' + b"0" * 10**6 + b"}"),
        1,
        {"payload"},
        PLAIN_FIELDS,
    ),
    Kind("JSON: 20 000 items a message", json_dense, 100, {"too_many_states"}, ITEM),
    # What is not known.
    Kind(
        "unknown compression",
        lambda: changed(WHOLE, MID + 9 + 32, b"zzzz"),
        MESSAGES - IN_MIDDLE,
        {"unknown_compression"},
    ),
    Kind("unknown and private opcodes", unknown_in_chunk, 2, {"unexpected_record", "unknown_record"}),
    Kind("opcode 0", lambda: changed(WHOLE, MID, b"\0"), MESSAGES - IN_MIDDLE, {"record_damaged"}),
    Kind(
        "unknown encodings",
        lambda: file_of(schema(1, "x", "capnproto", b""), channel(1, "/x", "cbor", 1), sample(1, b"")),
        1,
        {"nothing_understood"},
    ),
    Kind(
        "a schema that is none",
        lambda: file_of(
            schema(1, "osi3.GroundTruth", "protobuf", b"\xff" * 99),
            channel(1, "/x", "protobuf", 1),
            sample(1, b""),
        ),
        1,
        {"schema"},
    ),
    # Summaries.
    Kind(
        "no summary",
        lambda: whole(
            use_statistics=False, use_summary_offsets=False, repeat_channels=False, repeat_schemas=False
        ),
        MESSAGES,
    ),
    Kind(
        "summary elsewhere",
        lambda: changed(WHOLE, FOOTER + 9, struct.pack("<Q", 20)),
        MESSAGES,
        {"summary_damaged"},
    ),
    Kind(
        "summary outside the file",
        lambda: changed(WHOLE, FOOTER + 9, struct.pack("<Q", 2**50)),
        MESSAGES,
        {"summary_damaged"},
    ),
    Kind("statistics that are off", statistics_off, MESSAGES, {"statistics"}),
    # Ids.
    Kind(
        "a channel declared twice",
        lambda: file_of(ONE, sample(1, b"{}"), channel(1, "/y", "json"), sample(1, b"{}")),
        2,
        {"channel_conflict"},
    ),
    Kind(
        "a schema declared twice",
        lambda: file_of(schema(1, "a", "x", b""), schema(1, "b", "x", b""), ONE, sample(1, b"{}")),
        1,
        {"schema_conflict"},
    ),
    Kind(
        "a message of no channel",
        lambda: file_of(ONE, sample(7, b"{}"), sample(1, b"{}")),
        2,
        {"unknown_channel"},
    ),
    Kind(
        "a channel of no schema",
        lambda: file_of(channel(1, "/x", "json", 9), sample(1, b"{}")),
        1,
        {"missing_schema"},
    ),
    Kind("100 000 channels", lambda: channels(100_000), 1, {"channel_conflict"}),
    Kind("one channel a million times", same_channel, 0, {"chunk_damaged"}),
    Kind("900 000 messages of no channel", many_messages, 900_001, {"unknown_channel"}),
    Kind("3 million records of no use", useless, 1, {"unexpected_record"}),
    Kind(
        "100 000 metadata records",
        lambda: file_of(record(0x0C, text("m") + text(b"")) * 100_000),
        0,
        {"too_many_records"},
    ),
    Kind("times of 2^64 - 1", lambda: file_of(ONE, sample(1, b"{}", 2**64 - 1)), 1),
    # Texts.
    Kind(
        "a topic that is not UTF-8",
        lambda: file_of(channel(1, b"/\xff\xfe", "json"), sample(1, b"{}")),
        1,
        {"not_utf8"},
    ),
    Kind("JSON that is not UTF-8", lambda: json_of(b'{"x_m": "\xff"}'), 1),
    # Around the file.
    Kind("two files joined", lambda: WHOLE + WHOLE, 2 * MESSAGES, {"joined_files"}),
    Kind("trailing bytes", lambda: WHOLE + b"\0" * 100, MESSAGES, {"trailing_bytes"}),
    Kind(
        "a git-lfs pointer", lambda: b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n", -1
    ),
    Kind("an empty file", lambda: b"", -1),
    Kind("a ROS 1 bag", lambda: b"#ROSBAG V2.0\n" + bytes(100), -1),
    Kind("an SQLite database", lambda: b"SQLite format 3\0" + bytes(100), -1),
    Kind("a gzip of a log", lambda: gzip.compress(WHOLE), -1),
    Kind("the magic alone", lambda: MAGIC, 0, {"truncated"}),
)


# --- the table -----------------------------------------------------------------------------------


#: Runs the command, then tells the memory that this process held at most [KiB].
_RUN = """
import atexit, sys
from pathlib import Path
def peak():
    status = Path("/proc/self/status")
    if status.exists():
        lines = status.read_text().splitlines()
        print(next(line for line in lines if line.startswith("VmHWM")), file=sys.stderr)
atexit.register(peak)
from istc_replay.cli import main
main()
"""


def config_of(fields: dict[str, str]) -> str:
    """The configuration that reads /x by a mapping."""
    told = "".join(f'{name} = "{path}"\n' for name, path in fields.items() if name != "items")
    items = f'items = "{fields["items"]}"\n' if "items" in fields else ""
    return f'[ingest.topics."/x"]\n{items}[ingest.topics."/x".fields]\n{told}' if fields else ""


def measure(path: Path, fields: dict[str, str]) -> tuple[int, dict[str, object], float, float, str]:
    """Exit code, facts, processor seconds, peak MiB and stderr of one `info --json`."""
    command = [sys.executable, "-c", _RUN, "info", "--json", str(path)]
    if fields:
        config = path.with_suffix(".toml")
        config.write_text(config_of(fields))
        command += ["-c", str(config)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:  # noqa: S603
        out, err = process.stdout.read(), process.stderr.read()  # type: ignore[union-attr]
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    facts = json.loads(out) if out else {}
    seconds = usage.ru_utime + usage.ru_stime
    lines = err.decode().splitlines(keepends=True)
    peak = [int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM")]
    err_text = "".join(line for line in lines if not line.startswith("VmHWM"))
    return process.returncode, facts, seconds, peak[0] if peak else usage.ru_maxrss / 1024, err_text


def faults(
    kind: Kind, code: int, facts: dict[str, object], seconds: float, peak: float, err: str
) -> list[str]:
    """Say what of the promise one kind breaks."""
    found = []
    codes = {problem["code"] for problem in facts.get("problems", ())}  # type: ignore[attr-defined]
    if "Traceback" in err or code not in (0, 3):
        found.append(f"exit code {code}: {err[-300:]}")
    if kind.intact == -1:
        if code != 3 or err.count("\n") != 1:
            found.append("not refused in a line")
    elif kind.intact is not None and facts.get("messages") != kind.intact:
        found.append(f"{facts.get('messages')} messages, {kind.intact} are intact")
    if not kind.codes <= codes:
        found.append(f"not told: {', '.join(sorted(kind.codes - codes))}")
    if seconds > LIMIT_S or peak > LIMIT_MIB:
        found.append(f"{seconds:.2f} s, {peak:.0f} MiB")
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="", help="only the kinds whose name holds this")
    options = parser.parse_args()
    wrong = []
    print("| damage | bytes | messages recovered | told as | s | MiB |")
    print("|---|---|---|---|---|---|")
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.mcap"
        for kind in KINDS:
            if options.only not in kind.name:
                continue
            data = kind.data()
            path.write_bytes(data)
            code, facts, seconds, peak, err = measure(path, kind.fields)
            told = sorted({problem["code"] for problem in facts.get("problems", ())})  # type: ignore[attr-defined]
            found = facts.get("messages")
            shown = (
                "refused"
                if found is None
                else f"{found}" + ("" if kind.intact is None else f" of {kind.intact}")
            )
            words = ", ".join(told) or ("" if found is not None else err.split(": ")[-1].strip()[:60])
            print(
                f"| {kind.name} | {len(data)} | {shown} | {words} | {seconds:.2f} | {peak:.0f} |", flush=True
            )
            wrong += [f"{kind.name}: {fault}" for fault in faults(kind, code, facts, seconds, peak, err)]
    print(f"{len(KINDS)} kinds in {time.monotonic() - began:.0f} s", file=sys.stderr)
    for fault in wrong:
        print(fault, file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
