"""Thresholds are those of the configuration, and say so."""

from __future__ import annotations

from istc_replay.config import AuditConfig, parse_config
from istc_replay.safety.log_audit import audit_log
from istc_replay.safety.rules import CORRIDOR_RULE, PAIR_RULES, PET_RULE, VEHICLE_RULES

from ..support.encounters import near_miss
from ..support.tracks import log_of


def test_thresholds_are_those_of_the_configuration_and_say_so() -> None:
    log = log_of(*near_miss())
    config = parse_config("[audit]\npet_critical_s = 0.2\npet_serious_s = 0.3")
    found = audit_log(log, config).findings
    assert found["severity"].to_list() == ["minor"]
    assert found["threshold_source"].to_list() == ["SSAM"]
    moved = audit_log(log, parse_config("[audit]\npet_critical_s = 0.9")).findings
    assert moved["threshold_source"].to_list() == ["configured: audit.pet_critical_s"]
    assert moved["finding_id"].to_list() == found["finding_id"].to_list()


def test_every_level_of_every_rule_is_configurable_and_says_so() -> None:
    for rule in (*PAIR_RULES, PET_RULE, *VEHICLE_RULES, CORRIDOR_RULE):
        for level in rule.levels:
            if level is None or not isinstance(level[0], str):
                continue
            key = level[0]
            default = AuditConfig.model_fields[key].default or 10.0  # unset, or a limit of zero
            # A hair past the default, so that the order of the levels stands.
            changed = AuditConfig.model_validate({key: default * (1.0 + 1e-9)})
            sources = {value: source for _, value, source in rule.thresholds(changed)}
            assert sources[default * (1.0 + 1e-9)] == f"configured: audit.{key}", (rule.name, key)
