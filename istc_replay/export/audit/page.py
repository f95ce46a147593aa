"""audit.html: one self-contained file with the summary, the timeline, the encounters and the proofs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import polars as pl

from istc_replay.datatypes import Verdict
from istc_replay.export.audit.encounters import encounters_section
from istc_replay.export.audit.links import Links
from istc_replay.export.audit.markdown import judged_share
from istc_replay.export.audit.pictures import Recording, draw_timeline, recording_of
from istc_replay.export.figures import figure_bytes
from istc_replay.export.figures.style import drawing_style
from istc_replay.export.report.findings import against_plan_table, findings_table
from istc_replay.export.report.header import moment
from istc_replay.export.report.markup import (
    NOTHING,
    Content,
    Html,
    captioned,
    element,
    facts,
    join,
    names,
    number,
    prose,
    table,
)
from istc_replay.export.report.page import page
from istc_replay.export.report.pictures import inline_svg
from istc_replay.export.report.window import certificates_table
from istc_replay.export.text import shortened, visible
from istc_replay.safety.log_audit import Audit
from istc_replay.safety.rules import (
    CORRIDOR_RULE,
    PAIR_RULES,
    PET_RULE,
    RULE_NAMES,
    SEVERITIES,
    VEHICLE_RULES,
)
from istc_replay.units import NS_PER_S

#: Rows and windows of one section; the tables have them all.
_LISTED = 200


def audit_html(audit: Audit, clips: Mapping[str, Path] | None = None) -> str:
    """Write the audit's report.

    Parameters
    ----------
    audit : Audit
        The audit; names in it may hold anything.
    clips : mapping of str to Path, optional
        Clips of the log by the id of an encounter or finding, relative to the report.

    Returns
    -------
    str
        An HTML document that loads nothing and runs nothing; the same audit gives the same text.
    """
    recording = recording_of(audit)
    links = Links(audit.origin_ns, clips or {})
    single = pl.col("encounter_id").is_null()
    behaviour = audit.findings.filter(pl.col("severity").is_not_null())
    body = [
        _head(audit),
        _verdict(audit),
        _timeline(recording),
        encounters_section(recording, links),
        _listed("Single vehicles", behaviour.filter(single), recording, links),
        _listed("Data quality", audit.findings.filter(pl.col("severity").is_null()), recording, links),
        _plans(audit),
        _listed("All findings of pairs", behaviour.filter(~single), recording, links),
        _coverage(audit),
        _thresholds(audit),
    ]
    return page(f"{Path(audit.log.path).name}: audit", body)


def _head(audit: Audit) -> Html:
    log, title = audit.log, Path(audit.log.path).name
    first, last = log.states["time_ns"].min(), log.states["time_ns"].max()
    span = (last - first) / NS_PER_S if isinstance(first, int) and isinstance(last, int) else None
    state, tone = (
        ("complete", "good") if log.complete else ("not complete: it ends early or is damaged", "bad")
    )
    what = "a result: its recording and its plans" if audit.of_result else "a log"
    known = [
        ("What was audited", what),
        ("The log is", element("span", state, class_=tone)),
        ("SHA-256", element("span", log.sha256[:16] or NOTHING, class_="hash")),
        ("Begins", moment(first)),
        ("Length", number(span, 1, "s")),
        ("Road users", number(int(log.states["vehicle_id"].n_unique()))),
        ("Encounters", number(audit.encounters.height)),
        ("Judged", judged_share(audit)),
    ]
    return join(
        [element("h1", "Safety audit of ", element("bdi", visible(shortened(title, 200)))), facts(known)]
    )


def _verdict(audit: Audit) -> Html:
    counts = audit.counts
    told = ", ".join(f"{counts[severity]} {severity}" for severity in reversed(SEVERITIES))
    tone, words = {
        Verdict.PASS: ("good", "✓ Nothing was found in what was judged."),
        Verdict.FAIL: ("bad" if counts["critical"] + counts["serious"] else "open", f"✗ Findings: {told}."),
    }.get(audit.verdict, ("open", "? Not conclusive: nothing was found, and not all could be judged."))
    doubt = f"{audit.in_doubt} findings are of doubtful data, or rest on them." if audit.in_doubt else None
    checks = _proven(audit) if audit.of_result else None
    if Verdict.FAIL.value in set(audit.certificates["verdict"]):
        tone = "bad"
    return element(
        "div",
        element("p", words),
        element("p", checks) if checks else None,
        element("p", doubt) if doubt else None,
        class_=f"verdict {tone}",
    )


def _proven(audit: Audit) -> Content:
    failed = audit.certificates.filter(pl.col("verdict") == Verdict.FAIL.value)["check"].unique().sort()
    if len(failed):
        return join(["✗ Checks of the plans that fail: ", names(failed), "."])
    if Verdict.INCONCLUSIVE.value in set(audit.certificates["verdict"]):
        return "? Not every check of the plans could be judged."
    return "No plan was certified." if audit.certificates.is_empty() else "✓ Every check of the plans passes."


def _timeline(recording: Recording) -> Html | None:
    if recording.audit.findings.is_empty():
        return None
    with drawing_style():
        figure = draw_timeline(recording)
    counts = recording.audit.findings.group_by("rule").len().sort("rule")
    told = ", ".join(f"{count} of {rule.replace('_', ' ')}" for rule, count in counts.iter_rows())
    svg = inline_svg(figure_bytes(figure, "svg"), "timeline", f"Findings over time by rule: {told}.")
    caption = (
        "When findings lie: a bar from start to end, a mark where each is worst. Crosses are critical, "
        "diamonds serious, dots minor, strokes data in doubt."
    )
    return join([element("h2", "Timeline"), captioned(svg, caption)])


def _listed(title: str, findings: pl.DataFrame, recording: Recording, links: Links) -> Html | None:
    if findings.is_empty():
        return None
    caption = f"{findings.height} findings, worst first"
    shown = findings_table(findings, recording.start_ns, caption, _LISTED, links.of if links else None)
    return join([element("h2", title), shown])


def _plans(audit: Audit) -> Html | None:
    if not audit.of_result:
        return None
    shown: list[Html] = []
    for (window,), rows in sorted(audit.certificates.partition_by("window", as_dict=True).items())[:_LISTED]:
        start = rows["time_ns"].min()
        checks = certificates_table(rows.to_dicts(), start if isinstance(start, int) else 0)
        shown += [element("h3", f"Window {window}"), checks]
    none = element("p", "There is no plan.")
    compared = against_plan_table(audit.against_plan.head(_LISTED).to_dicts(), windows=True)
    against = join([element("h3", "Recorded against planned"), compared]) if compared else None
    return join([element("h2", "Plans, certified anew"), shown or none, against])


def _coverage(audit: Audit) -> Html:
    rows = []
    for rule in RULE_NAMES:
        own = audit.coverage.filter(pl.col("rule") == rule)
        if own.is_empty():
            continue
        counts = [int((own["verdict"] == verdict.value).sum()) for verdict in Verdict]
        apply = own.filter(pl.col("verdict") != Verdict.NOT_APPLICABLE.value)
        recorded, judged = (float(apply[column].sum()) for column in ("recorded_s", "judged_s"))
        share = number(100.0 * judged / recorded, 1) if recorded else NOTHING
        rows.append((rule.replace("_", " "), *map(number, counts), number(judged, 1), share))
    headings = ("Rule", "pass", "findings", "inconclusive", "not applicable", "judged [s]", "judged [%]")
    sized = audit.coverage.unique("vehicle_id")["dimensions_source"].value_counts(sort=True)
    told = ", ".join(f"{count} from {source}" for source, count in sized.iter_rows()) or NOTHING
    caption = (
        "How much was judged: road users by the outcome of each rule, and the time that it could be judged in"
    )
    listed = table(caption, headings, rows, range(1, 7))
    return join([element("h2", "Coverage"), listed, element("p", f"Sizes: {told}.")])


def _thresholds(audit: Audit) -> Html:
    rows = []
    for rule in (*PAIR_RULES, PET_RULE, *VEHICLE_RULES, CORRIDOR_RULE):
        levels = rule.thresholds(audit.config.audit)
        if levels:
            told = "; ".join(
                f"{severity} {number(level, 2)} ({source})" for severity, level, source in levels
            )
            rows.append(
                (rule.name.replace("_", " "), rule.unit.replace("^2", "²").replace("^3", "³"), prose(told))
            )
    listed = table("Thresholds in force, and who published them", ("Rule", "unit", "levels"), rows)
    return join([element("h2", "Thresholds"), listed])
