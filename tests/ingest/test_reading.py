"""Times, places, derived values and what the configuration chooses, over whole logs."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix

from istc_replay.config import parse_config
from istc_replay.ingest.log import read_log

from ..support.logs import T0_NS, Topic, vehicle_state, write_log

STEP_NS = 100_000_000


def codes(log: Any) -> list[str]:
    return [problem.code for problem in log.problems]


def json_topic(values: list[dict[str, Any]], name: str = "/s", step_ns: int = STEP_NS) -> Any:
    """A topic of JSON messages without a schema."""
    messages = [(T0_NS + k * step_ns, json.dumps(value).encode()) for k, value in enumerate(values)]
    return Topic(name, messages, "", "", b"", "json")


FIELDS = '[ingest.topics."/s".fields]\nvehicle_id = "id"\nx_m = "x"\ny_m = "y"\n'


def test_a_missing_heading_is_derived_from_the_way_and_held_while_standing(save: Any) -> None:
    places = [(0.0, 0.0), (0.0, 0.5), (0.0, 1.0), (0.0, 1.0), (0.0, 1.0), (0.0, 1.0)]
    made = json_topic([{"id": "a", "x": x, "y": y} for x, y in places])
    states = read_log(save(write_log(made)), parse_config(FIELDS)).states
    assert states["heading_rad"].to_list() == pytest.approx([math.pi / 2] * 6)
    assert all(mark & 1 for mark in states["derived"])
    assert states["speed_mps"].to_list() == pytest.approx([5.0, 5.0, 2.5, 0.0, 0.0, 0.0])


def test_a_text_for_a_number_is_unknown_and_told_once_a_channel_with_its_count(save: Any) -> None:
    def values(wrong: int) -> list[dict[str, Any]]:
        return [{"id": "a", "x": 1.0 * k, "y": 0.0, "v": "fast" if k < wrong else 10.0} for k in range(40)]

    made = (json_topic(values(wrong), name) for name, wrong in (("/s", 7), ("/t", 40), ("/u", 0)))
    fields = 'vehicle_id = "id"\nx_m = "x"\ny_m = "y"\nspeed_mps = "v"\n'
    log = read_log(
        save(write_log(*made)),
        parse_config("".join(f'[ingest.topics."/{name}".fields]\n{fields}' for name in "stu")),
    )
    told = {problem.detail for problem in log.problems if problem.code == "not_a_number"}
    assert told == {
        "speed_mps on '/s' is a text where a number is wanted; taken as unknown",
        "speed_mps on '/t' is a text where a number is wanted; taken as unknown",
        "6 more of this kind (/s, speed_mps)",
        "39 more of this kind (/t, speed_mps)",
    }
    assert log.complete


def test_a_vehicle_that_only_stands_has_no_heading(save: Any) -> None:
    made = json_topic([{"id": "a", "x": 1.0 + 0.001 * k, "y": 2.0} for k in range(5)])
    states = read_log(save(write_log(made)), parse_config(FIELDS)).states
    assert states["heading_rad"].null_count() == 5
    assert states["derived"].to_list() == [0] * 5


def test_one_gap_in_a_told_heading_is_not_filled(save: Any) -> None:
    values = [{"id": "a", "x": 1.0 * k, "y": 0.0, "yaw": 0.1} for k in range(5)]
    del values[2]["yaw"]
    made = json_topic(values)
    states = read_log(save(write_log(made)), parse_config(FIELDS + 'heading_rad = "yaw"\n')).states
    assert states["heading_rad"].to_list() == [0.1, 0.1, None, 0.1, 0.1]


@pytest.mark.parametrize(
    ("target", "path", "value", "expected_ns"),
    [
        ("time_ns", "t", 1_700_000_000_123_456_789, 1_700_000_000_123_456_789),
        ("time_s", "t", 12.25, 12_250_000_000),
        ("time", "t", {"sec": 5, "nanosec": 7}, 5_000_000_007),
        ("time", "t", {"secs": 5, "nsecs": 7}, 5_000_000_007),
        ("time", "t", {"seconds": 5}, 5_000_000_000),
    ],
)
def test_times_are_told_in_many_ways(target: str, path: str, value: Any, expected_ns: int, save: Any) -> None:
    made = json_topic([{"id": "a", "x": 1.0, "y": 2.0, "t": value}])
    log = read_log(save(write_log(made)), parse_config(f'{FIELDS}{target} = "{path}"\n'))
    assert log.problems == ()
    assert log.states["time_ns"].to_list() == [expected_ns]


@pytest.mark.parametrize("value", [2**62, 1e300, -(2**62)])
def test_times_beyond_int64_are_told(value: float, save: Any) -> None:
    made = json_topic([{"id": "a", "x": 1.0, "y": 2.0, "t": {"sec": value}}])
    log = read_log(save(write_log(made)), parse_config(f'{FIELDS}time = "t"\n'))
    assert (log.states.height, codes(log)) == (0, ["time_overflow"])


def test_a_clock_that_is_set_is_told(save: Any) -> None:
    stamps = [0.0, 0.1, 0.2, 5.3, 5.4, 5.5, 0.6]
    values = [{"id": "a", "x": 1.0 * k, "y": 0.0, "t": stamp} for k, stamp in enumerate(stamps)]
    log = read_log(save(write_log(json_topic(values))), parse_config(FIELDS + 'time_s = "t"\n'))
    assert codes(log) == ["backward_time", "clock_step"]
    by_log = read_log(
        save(write_log(json_topic(values))),
        parse_config('[ingest]\ntime_source = "log"\n' + FIELDS + 'time_s = "t"\n'),
    )
    assert codes(by_log) == []


def test_positions_on_the_earth_become_metres_of_a_stated_frame(save: Any) -> None:
    # A hundredth of a degree north of Paris is 1112.1 m, east 733.0 m, by WGS 84.
    messages = []
    for k, (lat, lon) in enumerate([(48.85, 2.35), (48.86, 2.35), (48.85, 2.36)]):
        fix = LocationFix(latitude=lat, longitude=lon)
        fix.timestamp.seconds = 1000 * k
        messages.append((T0_NS + k, fix.SerializeToString()))
    from foxglove_schemas_protobuf import LocationFix_pb2
    from google.protobuf import descriptor_pb2

    files = descriptor_pb2.FileDescriptorSet()
    for file in (*LocationFix_pb2.DESCRIPTOR.dependencies, LocationFix_pb2.DESCRIPTOR):
        file.CopyToProto(files.file.add())
    made = Topic("/car_1/fix", messages, "foxglove.LocationFix", schema_data=files.SerializeToString())
    log = read_log(save(write_log(made)))
    assert log.states["vehicle_id"].unique().to_list() == ["car_1"]
    assert log.states["x_m"].to_list() == pytest.approx([0.0, 0.0, 733.97], abs=0.2)
    assert log.states["y_m"].to_list() == pytest.approx([0.0, 1112.1, 0.05], abs=0.2)
    assert "local_origin" in codes(log)
    assert "48.85" in log.problems[0].detail


def test_a_vehicle_may_be_told_by_several_topics(save: Any) -> None:
    first = json_topic([{"id": "a", "x": 1.0 * k, "y": 0.0} for k in range(3)], "/s")
    second = json_topic([{"id": "a", "x": 9.0, "y": 0.0}], "/u")
    second.messages[0] = (T0_NS + 50_000_000, second.messages[0][1])
    log = read_log(save(write_log(first, second)), parse_config(FIELDS + FIELDS.replace("/s", "/u")))
    assert log.states["x_m"].to_list() == [0.0, 9.0, 1.0, 2.0]
    assert log.states["topic"].to_list() == ["/s", "/u", "/s", "/s"]
    assert codes(log) == ["no_header_time", "no_header_time", "no_header_time"]


def test_a_mapping_that_does_not_fit_is_told_in_a_line(save: Any) -> None:
    made = json_topic([{"id": "a", "x": "east", "y": [1]}, {"id": "a", "x": 1.0, "y": 2.0}])
    log = read_log(save(write_log(made)), parse_config(FIELDS))
    assert log.states.height <= 2
    assert all("\n" not in problem.detail for problem in log.problems)
    assert log.problems


def test_small_chunks_and_none_give_the_same(save: Any) -> None:
    def made() -> list[Any]:
        return [
            Topic(
                f"/v{v}",
                [
                    (T0_NS + k * STEP_NS + v, vehicle_state(T0_NS + k * STEP_NS, f"v{v}", x_m=k + 0.5 * v))
                    for k in range(40)
                ],
            )
            for v in range(3)
        ]

    tables = [
        read_log(save(write_log(*made(), **options))).states
        for options in (
            {},
            {"chunk_size": 300},
            {"use_chunking": False},
            {"chunk_size": 300, "use_statistics": False},
        )
    ]
    assert tables[0].height == 120
    assert all(table.equals(tables[0]) for table in tables[1:])


def test_a_json_payload_beyond_the_limit_is_told_where_it_is_the_only_one(save: Any) -> None:
    made = Topic("/s", [(T0_NS, b'{"x": "' + b"a" * 5 * 2**20 + b'"}')], "", "", b"", "json")
    log = read_log(save(write_log(made)), parse_config(FIELDS))
    assert (log.states.height, codes(log)) == (0, ["payload"])


def test_a_vehicle_id_that_is_no_number_is_read(save: Any) -> None:
    values = [{"id": value, "x": 1.0, "y": 2.0} for value in (float("nan"), 1.5, 1.25)]
    log = read_log(save(write_log(json_topic(values))), parse_config(FIELDS))
    assert sorted(log.states["vehicle_id"]) == ["1.25", "1.5", "nan"]
