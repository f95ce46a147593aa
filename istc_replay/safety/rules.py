"""The rules of the audit: which measure is judged by which thresholds, and who published them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import polars as pl

from istc_replay.config import AuditConfig
from istc_replay.datatypes import FloatArray

SEVERITIES = ("minor", "serious", "critical")


@dataclass(frozen=True, slots=True)
class Rule:
    """One rule: `sign` is 1 where larger values are worse, -1 where smaller ones are.

    `levels` pairs the key of the configuration (or a fixed value) with its source, by severity.
    """

    name: str
    column: str
    unit: str
    sign: int
    levels: tuple[tuple[str | float, str] | None, ...]

    def thresholds(self, audit: AuditConfig) -> list[tuple[str, float, str]]:
        """Severity, threshold and source of the levels that are set, least severe first."""
        found = []
        for severity, level in zip(SEVERITIES, self.levels, strict=False):
            if level is None:
                continue
            key, source = level
            if isinstance(key, str):
                value = getattr(audit, key)
                if value is None:
                    continue
                if value != AuditConfig.model_fields[key].default:
                    source = f"configured: audit.{key}"
                found.append((severity, float(value), source))
            else:
                found.append((severity, key, source))
        return found

    def badness(self, values: FloatArray) -> FloatArray:
        """Values turned so that larger is worse."""
        return np.asarray(self.sign * values)

    def release(self, audit: AuditConfig) -> float:
        """Badness below which an event ends."""
        first = self.thresholds(audit)[0][1]
        # Past a smaller threshold means a larger value.
        return self.sign * (first * audit.release_ratio if self.sign < 0 else first / audit.release_ratio)


def _levels(stem: str, unit: str, *sources: str) -> tuple[tuple[str | float, str], ...]:
    return tuple(
        (f"{stem}_{severity}_{unit}", source) for severity, source in zip(SEVERITIES, sources, strict=False)
    )


PAIR_RULES = (
    Rule("gap", "gap_m", "m", -1, (*_levels("gap", "m", "ours", "ours"), (0.0, "contact"))),
    Rule("ttc", "ttc_s", "s", -1, _levels("ttc", "s", "SUMO SSM device", "SSAM", "nuPlan")),
    Rule(
        "drac",
        "drac_mps2",
        "m/s^2",
        1,
        _levels("drac", "mps2", "SUMO SSM device", "Huber et al.", "Stellet et al., emergency braking"),
    ),
    Rule(
        "required_deceleration",
        "required_mps2",
        "m/s^2",
        1,
        _levels("required", "mps2", "SUMO SSM device", "Huber et al.", "Stellet et al., emergency braking"),
    ),
    Rule(
        "thw",
        "thw_s",
        "s",
        -1,
        _levels("thw", "s", "German advice", "German fine", "Austrian fine"),
    ),
    Rule("rss", "rss_margin_m", "m", -1, ((0.0, "Shalev-Shwartz et al. 2017, parameters of ad-rss"),)),
)

PET_RULE = Rule("pet", "pet_s", "s", -1, _levels("pet", "s", "SSAM", "Peesapati et al.", "Varhelyi"))

VEHICLE_RULES = (
    Rule(
        "braking",
        "acceleration_mps2",
        "m/s^2",
        1,
        _levels("braking", "mps2", "Huber et al.", "nuPlan", "Stellet et al., emergency braking"),
    ),
    Rule("lateral_acceleration", "lateral_mps2", "m/s^2", 1, _levels("lateral", "mps2", "nuPlan", "ours")),
    Rule("jerk", "jerk_mps3", "m/s^3", 1, _levels("jerk", "mps3", "nuPlan", "UN R157")),
    Rule("yaw_rate", "yaw_rate_radps", "rad/s", 1, _levels("yaw_rate", "radps", "nuPlan")),
    Rule(
        "curvature", "steering_rad", "rad", 1, (("steering_max_rad", "bicycle: tan(steering) / wheelbase"),)
    ),
    Rule("steering_rate", "steering_rate_radps", "rad/s", 1, (("steering_rate_max_radps", "bicycle, ours"),)),
    Rule("side_slip", "side_slip_rad", "rad", 1, (("side_slip_max_rad", "bicycle, ours"),)),
    Rule(
        "speed_limit",
        "overspeed_mps",
        "m/s",
        1,
        _levels("overspeed", "mps", "German tolerance", "German catalogue of fines", "German driving ban"),
    ),
)

#: Judged where there is a plan: how far the recorded box was out of its planned corridor.
CORRIDOR_RULE = Rule(
    "off_corridor", "deepest_m", "m", 1, _levels("off_corridor", "m", "ours", "ours", "ours")
)

#: Of a plan: feasible, but not proven optimal.
SOLVER_RULE = "not_proven_optimal"

#: Rules of data quality; their findings are inconclusive.
DATA_RULES = (
    "data_gap",
    "data_stamps",
    "data_clock_step",
    "data_clock_drift",
    "data_teleport",
    "data_id_switch",
    "data_heading",
    "data_frozen",
    "data_units",
    "data_dimensions",
    "data_overlap",
)

#: All rules in the order in which they are told.
RULE_NAMES = (
    *(rule.name for rule in (*PAIR_RULES, PET_RULE, *VEHICLE_RULES, CORRIDOR_RULE)),
    SOLVER_RULE,
    *DATA_RULES,
)


def worst_first(findings: pl.DataFrame) -> pl.DataFrame:
    """Findings (FINDINGS_SCHEMA) by severity, then by start; data quality comes last."""
    ranks = {severity: rank for rank, severity in enumerate(SEVERITIES)}
    rank = pl.col("severity").replace_strict(ranks, default=-1, return_dtype=pl.Int8)
    return findings.sort(rank, "start_ns", descending=[True, False], maintain_order=True)
