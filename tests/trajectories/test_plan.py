"""In-corridor trajectories: driven corridors, judged by another integrator in continuous time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from istc_replay.config import TrajectoriesConfig
from istc_replay.datatypes import SolveStatus, StartState
from istc_replay.errors import SolveError
from istc_replay.trajectories.plan import TrajectoryPlanner

from ..support import courses


def straight(units: int = 6, speed: float = 5.0, unit_s: float = 1.0) -> object:
    """A course along x at constant speed, in cubes half a metre wider than need be."""
    pivots = np.column_stack([np.arange(units + 1) * speed * unit_s, np.zeros(units + 1)])
    return courses.course_along(pivots, np.zeros(units + 1), speed, room_m=0.5, unit_s=unit_s)


def test_a_straight_corridor_is_driven_straight_at_constant_speed() -> None:
    trajectory = courses.planned(straight())
    assert trajectory.states[:, 0] + 1.35 == pytest.approx(5.0 * trajectory.times_s, abs=1e-3)
    assert np.abs(trajectory.states[:, 1:4]).max() < 1e-4
    assert trajectory.states[:, 4] == pytest.approx(5.0, abs=1e-3)
    assert trajectory.cost == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize(("unit_s", "room_m"), [(1.0, 0.0), (0.5, 0.0), (1.0, 1.0)])
def test_a_bending_corridor_holds_the_car_box_in_continuous_time(unit_s: float, room_m: float) -> None:
    course = courses.s_bend(units=round(8 / unit_s), room_m=room_m, unit_s=unit_s)
    assert courses.least_margin_m(courses.planned(course), course) > -1e-6


def test_a_tight_turn_is_driven_and_written_states_are_the_true_motion() -> None:
    pivots, headings = courses.driven_path(lambda t: min(t, 1.0) / 7.0, lambda _: 5.0, 5, 1.0)
    course = courses.course_along(pivots, headings, 5.0)
    trajectory = courses.planned(course)
    times, motion = courses.motion_at_1ms(trajectory)
    at_knots = motion[np.searchsorted(times, trajectory.times_s - 1e-9)]
    assert trajectory.states == pytest.approx(at_knots, abs=2e-3)
    assert courses.least_margin_m(trajectory, course) > -1e-6


def test_without_a_margin_walls_are_moved_until_the_car_stays_inside() -> None:
    # The fastest way round keeps to the inner walls: they bind between the instants of the NLP.
    course = courses.s_bend(radius_m=8.0)
    course = replace(course, pivots=course.pivots + [0.0, 0.8])
    course = replace(course, start=replace(course.start, y_m=float(course.start.y_m)))
    outcome = courses.plan(course, TrajectoriesConfig(margin_m=0.0))
    assert [record.stage for record in outcome.records].count("nlp") > 1
    assert courses.least_margin_m(outcome.trajectory, course) > -1e-6


def test_limits_hold_between_the_knots_too() -> None:
    course = courses.s_bend(radius_m=7.0)
    # Pivotal points that ask for more than the limits give.
    stretched = replace(course, cubes=course.cubes + np.array([-3.0, 3.0, -3.0, 3.0]))
    config = TrajectoriesConfig(
        steering_rate_max_radps=0.3,
        jerk_max_mps3=2.0,
        steering_max_rad=0.25,
        pivotal_x_weight=50.0,
        pivotal_y_weight=50.0,
    )
    outcome = courses.plan(stretched, config, speed_max_mps=5.2)
    trajectory = outcome.trajectory
    _, motion = courses.motion_at_1ms(trajectory)
    beta, jerk = np.abs(trajectory.controls).max(axis=0)
    assert beta <= 0.3 + 1e-6
    assert jerk <= 2.0 + 1e-6
    assert np.abs(motion[:, 3]).max() == pytest.approx(0.25, abs=1e-5)  # at its limit, not beyond
    assert motion[:, 4].min() >= -1e-5
    assert motion[:, 4].max() <= 5.2 + 1e-5
    assert motion[:, 5].min() >= -4.0 - 1e-5
    assert motion[:, 5].max() <= 3.0 + 1e-5


def test_a_car_that_must_stop_stops_and_never_reverses() -> None:
    reached = np.array([0.0, 5.0, 9.5, 12.0, 12.8, 12.8, 12.8])
    pivots = np.column_stack([reached, np.zeros(7)])
    course = courses.course_along(pivots, np.zeros(7), 5.0)
    trajectory = courses.planned(course)
    _, motion = courses.motion_at_1ms(trajectory)
    assert motion[:, 4].min() >= -1e-5
    assert motion[-1, 4] < 0.2
    assert courses.least_margin_m(trajectory, course) > -1e-6


def test_a_standing_car_starts_off() -> None:
    reached = np.array([0.0, 0.4, 2.0, 5.0, 9.0])
    course = courses.course_along(np.column_stack([reached, np.zeros(5)]), np.zeros(5), 0.0)
    trajectory = courses.planned(course)
    assert trajectory.states[0, 4] == 0.0
    assert trajectory.states[-1, 0] + 1.35 == pytest.approx(9.0, abs=0.3)
    assert courses.least_margin_m(trajectory, course) > -1e-6


def test_a_standing_car_stands_in_a_cube_that_touches_it() -> None:
    course = courses.course_along(np.zeros((5, 2)), np.full(5, 0.3), 0.0, slack_rad=0.0)
    trajectory = courses.planned(course)
    assert np.ptp(trajectory.states[:, :3], axis=0).max() < 1e-5
    assert courses.least_margin_m(trajectory, course) > -1e-6


def test_a_recorded_deceleration_does_not_make_a_standing_car_reverse() -> None:
    course = courses.course_along(np.zeros((4, 2)), np.zeros(4), 0.0)
    start = replace(course.start, speed_mps=-0.03, acceleration_mps2=-0.5)
    trajectory = courses.planned(replace(course, start=start))
    assert courses.motion_at_1ms(trajectory)[1][:, 4].min() >= -1e-5


@pytest.mark.parametrize("units", [1, 2])
def test_short_corridors_are_driven(units: int) -> None:
    course = courses.s_bend(units=units)
    trajectory = courses.planned(course)
    assert len(trajectory.times_s) == 5 * units + 1
    assert courses.least_margin_m(trajectory, course) > -1e-6


def test_a_mirrored_corridor_gives_the_mirrored_trajectory() -> None:
    course = courses.s_bend()
    one, other = courses.planned(course), courses.planned(course.mirrored())
    assert other.states * [1, -1, -1, -1, 1, 1] == pytest.approx(one.states, abs=2e-3)
    assert other.cost == pytest.approx(one.cost, rel=1e-5)


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_a_corridor_turned_and_moved_gives_the_trajectory_turned_and_moved(quarters: int) -> None:
    # Two quarters put the start's heading at -pi, and the guidance's on either side of it.
    course = courses.s_bend()
    one, other = courses.planned(course), courses.planned(course.turned(quarters, (3000.0, -2000.0)))
    angle = quarters * np.pi / 2
    c, s = np.cos(angle), np.sin(angle)
    back = (other.states[:, :2] - [3000.0, -2000.0]) @ np.array([[c, -s], [s, c]])
    assert back == pytest.approx(one.states[:, :2], abs=2e-3)
    assert np.exp(1j * other.states[:, 2]) == pytest.approx(np.exp(1j * (one.states[:, 2] + angle)), abs=2e-3)
    assert np.abs(np.diff(other.states[:, 2])).max() < 0.5  # unwrapped


def test_a_jump_sideways_cannot_be_driven_and_names_its_unit() -> None:
    pivots = np.column_stack([np.arange(9) * 5.0, np.where(np.arange(9) < 5, 0.0, 4.0)])
    course = replace(courses.course_along(pivots, np.zeros(9), 5.0, slack_rad=0.05), first_unit=3)
    outcome = courses.plan(course)
    assert outcome.trajectory is None
    # The jump is inside the fifth cube of a vehicle that came in unit 3; its neighbours are narrow.
    assert outcome.undrivable.unit in (3 + 3, 3 + 4, 3 + 5)
    assert 0.1 < outcome.undrivable.slack_m < 3.0
    assert outcome.undrivable.vehicle_id == "a"
    assert f"{outcome.undrivable.slack_m:.3f} m" in outcome.undrivable.detail
    assert [record.stage for record in outcome.records] == ["nlp", "soft"]
    assert outcome.records[0].status is SolveStatus.INFEASIBLE
    assert outcome.records[1].status is SolveStatus.OPTIMAL


def test_a_corridor_of_one_cube_that_asks_for_too_much_is_undrivable() -> None:
    course = courses.course_along(np.array([[0.0, 0.0], [0.1, 0.0]]), np.zeros(2), 0.0)
    moved = replace(
        course, start=replace(course.start, speed_mps=9.9), cubes=np.array([[-2.0, 2.2, -1.0, 1.0]])
    )
    outcome = courses.plan(moved)
    assert outcome.undrivable.unit == 0
    assert outcome.undrivable.slack_m > 1.0
    assert [record.stage for record in outcome.records] == ["nlp", "soft"]


def test_cubes_that_do_not_meet_are_undrivable_where_they_part() -> None:
    course = straight()
    course.cubes[3:, 2:] += 6.0
    course.pivots[4:, 1] += 6.0
    outcome = courses.plan(course)
    assert outcome.undrivable.unit in (2, 3)
    assert [record.stage for record in outcome.records] == ["soft"]


def test_a_corridor_that_asks_for_too_much_speed_is_undrivable() -> None:
    assert courses.plan(straight(speed=5.0), speed_max_mps=6.0).undrivable is None
    fast = straight(speed=9.0)
    fast = replace(fast, start=replace(fast.start, speed_mps=5.0))
    outcome = courses.plan(fast, speed_max_mps=6.0)
    assert outcome.undrivable.unit >= 1
    assert outcome.undrivable.slack_m > 1.0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"speed_mps": 12.0}, "speed 12.000 m/s"),
        ({"speed_mps": -1.0}, "speed -1.000 m/s"),
        ({"steering_rad": 0.7}, "steering 0.700 rad"),
        ({"acceleration_mps2": -5.0}, "acceleration -5.000 m/s^2"),
        ({"y_m": 2.0}, "sticks out of its first cube by 1.500 m at y_max"),
    ],
)
def test_an_impossible_start_is_told_without_a_solve(change: dict[str, float], words: str) -> None:
    course = straight()
    # The cubes of the straight course leave 0.5 m to either side of the car-box at the start.
    course.cubes[0, 2:] = (-1.5, 1.5)
    outcome = courses.plan(replace(course, start=replace(course.start, **change)))
    assert words in outcome.undrivable.detail
    assert outcome.undrivable.unit == 0
    assert outcome.records == ()


def test_known_steering_and_acceleration_are_kept_at_the_start() -> None:
    course = straight()
    start = StartState(0.0, 0.0, 0.0, 5.0, steering_rad=0.1, acceleration_mps2=-1.0)
    trajectory = courses.planned(replace(course, start=start))
    assert trajectory.states[0] == pytest.approx([-1.35, 0.0, 0.0, 0.1, 5.0, -1.0], abs=1e-9)


def test_costs_are_the_sums_of_equations_13_to_15() -> None:
    course = courses.s_bend()
    trajectory = courses.planned(course)
    x, y, heading, delta = trajectory.states[:, :4].T
    centre = np.column_stack([x + 1.35 * np.cos(heading), y + 1.35 * np.sin(heading)])
    units = np.arange(len(course.pivots)) * course.unit_s
    aimed = np.column_stack([np.interp(trajectory.times_s, units, course.pivots[:, i]) for i in (0, 1)])
    beta, jerk = trajectory.controls.T
    assert trajectory.costs == pytest.approx(
        {
            "smoothness": np.sum((np.tan(delta) / 2.7) ** 2),
            "comfort": 100 * np.sum(beta**2) + np.sum(jerk**2),
            "pivotal": np.sum((centre - aimed) ** 2),
        },
        rel=1e-9,
    )
    assert trajectory.cost == pytest.approx(sum(trajectory.costs.values()))


def test_every_solve_is_recorded() -> None:
    outcome = courses.plan(courses.s_bend())
    (record,) = outcome.records
    assert (record.layer, record.stage, record.solver, record.vehicle_id) == (
        "trajectory",
        "nlp",
        "piqp, ipopt",
        "a",
    )
    assert record.status is SolveStatus.OPTIMAL
    assert record.objective == pytest.approx(outcome.trajectory.cost)
    assert 0 < record.iterations < 100
    assert record.wall_s > 0.0


def test_an_iteration_budget_that_ends_first_is_told() -> None:
    outcome = courses.plan(courses.s_bend(), TrajectoriesConfig(iteration_budget=1))
    assert {record.status for record in outcome.records} == {SolveStatus.LIMIT}
    assert "no trajectory found" in outcome.undrivable.detail


def test_the_same_course_gives_the_same_trajectory_whatever_was_planned_before() -> None:
    planner = TrajectoryPlanner(TrajectoriesConfig(), 1.0)
    first = courses.plan(courses.s_bend(), planner=planner)
    courses.plan(courses.s_bend(radius_m=9.0), planner=planner)
    courses.plan(courses.s_bend(units=3), planner=planner)
    again = courses.plan(courses.s_bend(), planner=planner)
    fresh = courses.plan(courses.s_bend())
    for other in (again, fresh):
        assert np.array_equal(other.trajectory.states, first.trajectory.states)
        assert np.array_equal(other.trajectory.controls, first.trajectory.controls)


def test_times_count_from_the_windows_start_and_intervals_divide_the_unit() -> None:
    course = replace(courses.s_bend(units=6, unit_s=0.5), first_unit=4)
    trajectory = courses.planned(course)
    assert trajectory.times_s == pytest.approx(2.0 + np.arange(13) / 4)  # 0.2 s does not divide 0.5 s
    assert trajectory.states.shape == (13, 6)
    assert trajectory.controls.shape == (12, 2)
    assert not trajectory.states.flags.writeable


def test_eulers_paper_mode_follows_the_printed_update_and_says_that_it_drifts() -> None:
    outcome = courses.plan(courses.s_bend(), TrajectoriesConfig(integrator="euler", step_s=0.1))
    states, controls = outcome.trajectory.states, outcome.trajectory.controls
    theta, delta, v, a = states[:-1, 2:].T
    beta, jerk = controls.T
    rates = [v * np.cos(theta), v * np.sin(theta), v * np.tan(delta) / 2.7, beta, a, jerk]
    assert states[1:] == pytest.approx(states[:-1] + 0.1 * np.column_stack(rates), abs=1e-6)
    assert "drifts" in outcome.records[0].detail


def test_nothing_is_printed(capfd: pytest.CaptureFixture[str]) -> None:
    courses.plan(courses.s_bend(units=2))
    jump = np.column_stack([np.arange(9) * 5.0, np.where(np.arange(9) < 5, 0.0, 4.0)])
    courses.plan(courses.course_along(jump, np.zeros(9), 5.0, slack_rad=0.05))
    captured = capfd.readouterr()
    assert captured.out == ""
    assert captured.err == ""


def test_a_corridor_of_wrong_shape_or_without_numbers_is_refused() -> None:
    course = straight()
    with pytest.raises(SolveError, match=r"shapes .* do not make a corridor"):
        courses.plan(replace(course, headings=course.headings[:-1]))
    course.cubes[2, 1] = np.nan
    with pytest.raises(SolveError, match="not finite"):
        courses.plan(course)


def test_a_step_that_would_exhaust_memory_is_refused() -> None:
    with pytest.raises(SolveError, match="raise step_s"):
        courses.plan(straight(), TrajectoriesConfig(step_s=1e-6))
