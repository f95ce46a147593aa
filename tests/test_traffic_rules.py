"""Rules of recorded traffic: queues, catching up, gaps, cones, partial plans."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from istc_replay.config import Config, parse_config
from istc_replay.corridors.formulation import build_problem, default_limits
from istc_replay.datatypes import (
    Participant,
    StartState,
    WindowStatus,
    read_only,
)
from istc_replay.field import Field, back_to_recording
from istc_replay.scenario import build_scenario
from istc_replay.windows import settled_config

from .support.planning import FAST, first_part, planned
from .support.tracks import driver, log_of


def participant() -> Participant:
    """A car of a window of four seconds at 10 m/s."""
    log = log_of(driver("1", speed_mps=10.0))
    config = settled_config(log, Config())
    return build_scenario(first_part(log, config), config, 0.5).participants[0]


def test_who_queues_in_a_window_is_planned_and_who_never_moves_is_parked() -> None:
    # It stands in the first window and drives on in the second.
    queued = 30.0 + 8.0 * np.maximum(np.arange(161) / 10.0 - 8.0, 0.0)
    config = Config.model_validate({"window": {"horizon_s": 8.0, "stride_s": 8.0}})
    log = log_of(
        driver("1", 8.0, seconds=16.0),
        driver("queued", seconds=16.0, x_m=queued, speed_mps=np.gradient(queued, 0.1)),
        driver("parked", -6.0, 60.0, 0.0, seconds=16.0),
    )
    scenario = build_scenario(first_part(log, config), config, 0.5)
    assert [p.vehicle_id for p in scenario.participants] == ["1", "queued"]
    assert {e.vehicle_id: e.reason for e in scenario.excluded} == {"parked": "parked"}


@pytest.mark.parametrize(("behind_m", "faster"), [(6.0, True), (-6.0, False)])
def test_who_was_led_off_its_recording_comes_back_to_it_by_a_fifth_of_its_speed(
    behind_m: float, faster: bool
) -> None:
    own = participant()
    before = own.recording.poses[0] + np.column_stack([np.linspace(-40.0, 0.0, 41), np.zeros((41, 2))])
    start = StartState(own.start.x_m - behind_m, own.start.y_m, own.start.heading_rad, 10.0, 0.0, 0.0)
    led = replace(own, start=start, approach=read_only(before))
    at_s = np.arange(0.0, 4.01, 0.25)
    targets = back_to_recording(led, at_s)
    recorded = np.interp(at_s, own.recording.times_s, own.recording.poses[:, 0])
    gap = recorded - targets[:, 0]
    assert gap[0] == pytest.approx(behind_m)
    back = int(np.flatnonzero(np.append(np.abs(gap) < 0.5, True))[0])
    assert (np.diff(np.abs(gap[: back + 1])) <= 1e-9).all()  # never farther from it
    assert (np.abs(gap[back:]) < 1.0).all()  # it eases, and no harder than a car does with comfort
    assert abs(gap[-1]) < 0.6 * abs(behind_m)
    speed = np.diff(targets[:, 0]) / 0.25
    most, least = 10.0 * 1.2 + 0.5, 10.0 / 1.2
    assert speed.max() <= most + 1e-6 if faster else speed.min() >= least - 1e-6
    # Who is where it was recorded stays with it.
    same = back_to_recording(replace(led, start=own.start), at_s)
    np.testing.assert_allclose(same[:, 0], recorded, atol=1e-6)


def test_gaps_are_lowered_to_a_third_and_then_to_none_for_those_that_need_it() -> None:
    plan = planned(log_of(driver("1"), driver("2", 4.0)))
    field = Field(plan.scenario, plan.guidance, 0.3, 0.2)
    steps = []
    while field.lower_gaps([("1", "2")]):
        steps.append((field.vehicle_gap_m, field.obstacle_gap_m))
    assert steps == [(pytest.approx(0.1), 0.2), (pytest.approx(0.1 / 3.0), 0.2), (0.0, 0.2)]
    assert not field.lower_gaps([("1",)])  # nobody whom a gap would help


@pytest.mark.parametrize(("slack_rad", "cone"), [(0.2, np.tan(0.2)), (0.001, 0.03), (0.6, 0.4)])
def test_a_pivotal_step_goes_sideways_by_the_tangent_of_the_heading_slack_and_a_little_at_least(
    slack_rad: float, cone: float
) -> None:
    plan = planned(log_of(driver("1", speed_mps=30.0)))
    (guide,) = plan.guidance
    narrow = replace(guide, slack_rad=read_only(np.full(len(guide.points_m), slack_rad)))
    limits = {"1": default_limits(FAST.corridors)}
    problem = build_problem(plan.scenario, [narrow], FAST.corridors, limits, 40.0)
    (block,), rows = problem.blocks, problem.rows
    chord = guide.points_m[2] - guide.points_m[1]
    along = chord / np.hypot(*chord)
    across = np.array([-along[1], along[0]])
    # The rows of the cone are those of two pivotal points with one bound.
    of_step = (rows.index[:, :4] == np.concatenate([block.pivot[2], block.pivot[1]])).all(axis=1)
    of_step &= (rows.index[:, 4:] == -1).all(axis=1) & np.isinf(rows.upper)
    assert of_step.sum() == 2

    def room(sideways: float) -> float:
        """The least room in the rows of a step of 10 m that goes sideways by this share."""
        z = (problem.lower + problem.upper) / 2.0
        z[block.pivot[1]] = guide.points_m[1]
        z[block.pivot[2]] = guide.points_m[1] + 10.0 * (along + sideways * across)
        return float((rows.value(z) - rows.lower)[of_step].min())

    assert min(room(0.99 * cone), room(-0.99 * cone)) > 0.0
    assert max(room(1.01 * cone), room(-1.01 * cone)) < 0.0


def test_of_two_partial_plans_that_of_more_vehicles_is_kept_and_the_window_is_partial() -> None:
    # Bumper to bumper at 12 m/s there is no way at any time unit: the two stay as recorded.
    log = log_of(driver("1"), driver("9", 0.0, 4.55), driver("2", 6.0))
    plan = planned(log)
    assert plan.status is WindowStatus.NOT_CERTIFIED  # until the certificate has said so
    assert [t.vehicle_id for t in plan.trajectories] == ["2"]
    assert {e.vehicle_id for e in plan.frozen} == {"1", "9"}
    assert plan.scenario.window.unit_s in (0.125, 0.25)


@pytest.mark.parametrize(
    ("limit", "ahead_m", "lane_m", "reason"),
    # A car that can hardly brake, and one that has to swerve farther than the road lets it.
    [(0.3, 14.0, 0.4, "undrivable"), (1.0, 12.0, 1.0, "off_the_path")],
)
def test_who_cannot_be_driven_after_tightening_stays_as_recorded_by_name(
    limit: float, ahead_m: float, lane_m: float, reason: str
) -> None:
    stiff = parse_config(
        'corridors.mode = "fast"\nwindow.unit_s = 0.5\n'
        f"trajectories = {{ feedback_rounds = 1, deceleration_max_mps2 = {limit}, "
        f"acceleration_max_mps2 = {limit}, steering_rate_max_radps = 0.02 }}"
    )
    slow = driver("2", lane_m, ahead_m, 9.0)
    plan = planned(log_of(driver("1"), slow, driver("3", 8.0)), stiff)
    assert {e.vehicle_id: e.reason for e in plan.frozen} == {"1": reason, "2": reason}
    assert [t.vehicle_id for t in plan.trajectories] == ["3"]
    assert plan.rounds > 2  # it was tried with tighter limits first
    assert all("m" in e.detail for e in plan.frozen)
