"""What there is to say of a result as Foxglove log messages: verdicts, failed checks, findings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import polars as pl
from foxglove_schemas_protobuf.Log_pb2 import Log as LogMessage

from istc_replay.datatypes import Certificate, Verdict, WindowPlan, WindowStatus
from istc_replay.export.encode import by_time
from istc_replay.export.foxglove import timestamp
from istc_replay.export.stamped import Stamped, in_order, merged, place
from istc_replay.export.text import shortened, visible
from istc_replay.units import seconds_to_ns

TOPIC = "/istc/log"
_INFO, _WARNING, _ERROR = LogMessage.Level.INFO, LogMessage.Level.WARNING, LogMessage.Level.ERROR
_SEVERITIES = {"minor": _INFO, "serious": _WARNING, "critical": _ERROR}
_VERDICTS = {Verdict.FAIL: _ERROR, Verdict.INCONCLUSIVE: _WARNING}
_STATUSES = {
    WindowStatus.CERTIFIED: _INFO,
    WindowStatus.NOTHING_TO_PLAN: _INFO,
    WindowStatus.PARTIAL: _WARNING,
    WindowStatus.GOAL_NOT_REACHED: _WARNING,
}
#: Longer messages and names are cut.
_MESSAGE, _NAME = 1000, 60


def log_messages(
    plans: Sequence[WindowPlan],
    starts_ns: Mapping[int, int],
    certificates: Sequence[Certificate],
    findings: pl.DataFrame | None,
) -> Iterator[Stamped]:
    """Give `/istc/log`: each window's verdict, who is left out, checks that fail, findings; in order of time.

    A line names its source in `name`; a finding's `file` and `line` are the topic and the message
    that it rests on. Findings stand at their worst instants, failed checks at their witnesses.
    `starts_ns` are those of the windows by index.
    """
    windows = in_order((plan.scenario.window.start_ns, _window(plan)) for plan in plans)
    checks = sorted(_checks(certificates, starts_ns), key=place)
    return merged(windows, checks, _findings(findings) if findings is not None else ())


def _checks(certificates: Sequence[Certificate], starts_ns: Mapping[int, int]) -> Iterator[Stamped]:
    for check in certificates:
        level = _VERDICTS.get(check.verdict)
        if level is not None:
            time_ns = starts_ns[check.window] + (0 if check.time_s is None else seconds_to_ns(check.time_s))
            margin = "" if check.margin is None else f" by {check.margin:.4g} {check.unit}"
            text = f"{check.check}: {check.verdict}{margin}{_whom(check.vehicles)}"
            yield _said(time_ns, level, f"window {check.window}", text, check.detail)


def _findings(findings: pl.DataFrame) -> Iterator[Stamped]:
    for row in by_time(findings).iter_rows(named=True):
        told = row["value"]
        figure = "" if told is None else f" {told:.3g} {row['unit'] or ''}".rstrip()
        severity = row["severity"] or row["verdict"]
        text = f"{severity}: {row['rule']}{figure}{_whom(row['vehicles'] or ())}"
        level = _SEVERITIES.get(row["severity"], _INFO)
        where = row["topic"] or "", max(row["message_index"] or 0, 0)
        yield _said(row["worst_ns"], level, "audit", text, row["detail"], where)


def _window(plan: WindowPlan) -> Iterator[Stamped]:
    window, name = plan.scenario.window, f"window {plan.scenario.window.index}"
    status = str(plan.status).replace("_", " ")
    yield _said(window.start_ns, _STATUSES.get(plan.status, _ERROR), name, status, plan.reason)
    for left in (*plan.frozen, *plan.scenario.excluded):
        text = f"{shortened(left.vehicle_id, _NAME)} has no plan: {left.reason}"
        yield _said(window.start_ns, _WARNING, name, text, left.detail)


def _whom(vehicles: Sequence[str]) -> str:
    return f", {' and '.join(shortened(vehicle, _NAME) for vehicle in vehicles)}" if vehicles else ""


def _said(
    time_ns: int, level: int, name: str, text: str, detail: str | None, where: tuple[str, int] = ("", 0)
) -> Stamped:
    file, line = where
    text = f"{text}: {detail}" if detail else text
    message = LogMessage(
        timestamp=timestamp(time_ns),
        level=level,  # type: ignore[arg-type]
        name=name,
        message=visible(shortened(text, _MESSAGE)),
        file=visible(shortened(file, _MESSAGE)),
        line=min(line, 2**32 - 1),
    )
    return time_ns, TOPIC, message
