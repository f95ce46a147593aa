"""Static pictures: what they show, that they show it always alike, and that no name breaks them."""

from __future__ import annotations

import itertools
import xml.etree.ElementTree as ET
from dataclasses import replace

import matplotlib as mpl
import numpy as np
import polars as pl
import pytest
from matplotlib import _pylab_helpers
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from shapely import Polygon

from istc_replay.datatypes import Result
from istc_replay.errors import UsageError
from istc_replay.export.figures import draw_figures, draw_scene, figure_bytes, window_scene
from istc_replay.export.figures.closest import closest_pair
from istc_replay.export.figures.space_time import clip_segments
from istc_replay.export.figures.style import drawable
from istc_replay.export.figures.tracks import Track

from ..support.results import renamed, with_window

ALL = {"corridors", "own_corridors", "top_down", "filmstrip", "speed_acceleration", "separation"}
RECORDED = {"top_down", "filmstrip", "speed_acceleration", "separation"}


def without_plan(result: Result) -> Result:
    """The same result, whose window says that it has no plan although its tables hold one."""
    return with_window(result, status="no_corridors", reason="dead start")


@pytest.fixture(scope="module")
def figures(synthetic_result: Result) -> dict[str, Figure]:
    """The pictures of the synthetic window."""
    return draw_figures(synthetic_result, 0)


def test_a_planned_window_has_all_pictures(figures: dict[str, Figure]) -> None:
    assert set(figures) == ALL


def test_drawing_twice_gives_the_same_bytes(synthetic_result: Result, figures: dict[str, Figure]) -> None:
    again = draw_figures(synthetic_result, 0)
    for name, figure in figures.items():
        first = figure_bytes(figure, "svg")
        assert first == figure_bytes(again[name], "svg")
        assert b"<metadata>" not in first
    for file_format, magic in (("png", b"\x89PNG"), ("pdf", b"%PDF")):
        first = figure_bytes(figures["separation"], file_format)  # type: ignore[arg-type]
        assert first.startswith(magic)
        assert first == figure_bytes(again["separation"], file_format)  # type: ignore[arg-type]
        assert b"CreationDate" not in first


def test_settings_of_the_user_neither_matter_nor_change(
    synthetic_result: Result, figures: dict[str, Figure]
) -> None:
    with mpl.rc_context({"font.size": 30.0, "lines.linewidth": 9.0, "axes.grid": False, "svg.hashsalt": "x"}):
        before = dict(mpl.rcParams)
        other = figure_bytes(draw_figures(synthetic_result, 0)["separation"], "svg")
        assert dict(mpl.rcParams) == before
    assert other == figure_bytes(figures["separation"], "svg")
    assert not _pylab_helpers.Gcf.figs


def test_axes_are_labelled_with_units(figures: dict[str, Figure]) -> None:
    for name, figure in figures.items():
        for axes in figure.axes:
            labels = [axes.get_xlabel(), axes.get_ylabel()]
            if hasattr(axes, "get_zlabel"):
                labels.append(axes.get_zlabel())
                assert labels[-1] == "t [s]"
            if name in ("filmstrip", "speed_acceleration"):  # inner panels share the outer ones' labels
                labels = [label for label in labels if label]
            assert all("[" in label and label.endswith("]") for label in labels), (name, labels)
        assert any(axes.get_xlabel() for axes in figure.axes)
        assert any(axes.get_ylabel() for axes in figure.axes)


def test_metres_are_equally_long_in_both_directions(figures: dict[str, Figure]) -> None:
    for axes in figures["top_down"].axes + figures["filmstrip"].axes:
        assert axes.get_aspect() == 1.0
    axes = figures["corridors"].axes[0]
    x, y, _ = axes._box_aspect  # type: ignore[attr-defined]
    assert np.diff(axes.get_xlim())[0] / np.diff(axes.get_ylim())[0] == pytest.approx(x / y)


def test_every_cube_is_drawn_where_the_plan_has_it(
    synthetic_result: Result, figures: dict[str, Figure]
) -> None:
    prisms = next(
        child for child in figures["corridors"].axes[0].get_children() if isinstance(child, Poly3DCollection)
    )
    drawn = np.round(np.asarray(prisms._faces)[..., :3].reshape(-1, 3), 6)  # type: ignore[attr-defined]
    drawn_points = {tuple(point) for point in drawn}
    start_ns = synthetic_result.summary["windows"][0]["start_ns"]
    for row in synthetic_result.corridors.iter_rows(named=True):
        c, s = np.cos(row["frame_yaw_rad"]), np.sin(row["frame_yaw_rad"])
        corners = itertools.product(
            (row["x_min_m"], row["x_max_m"]), (row["y_min_m"], row["y_max_m"]), ("start_ns", "end_ns")
        )
        for x, y, when in corners:
            point = (
                c * x - s * y + row["frame_x_m"],
                s * x + c * y + row["frame_y_m"],
                (row[when] - start_ns) / 1e9,
            )
            assert tuple(np.round(point, 6)) in drawn_points


def test_corridors_of_different_vehicles_differ_in_more_than_colour(synthetic_result: Result) -> None:
    styles = window_scene(synthetic_result, 0).styles.values()
    assert len({style.marker for style in styles}) == len(styles)
    assert len({style.colour for style in styles}) == len(styles)


def test_a_window_without_a_plan_shows_the_recording_alone(synthetic_result: Result) -> None:
    scene = window_scene(without_plan(synthetic_result), 0)
    assert not scene.planned
    assert not scene.corridors
    assert not scene.guidance
    drawn = draw_scene(scene)
    assert set(drawn) == RECORDED
    assert [axes.get_title(loc="left").split(";")[0] for axes in drawn["top_down"].axes] == ["recorded"]
    assert b"planned" not in b"".join(figure_bytes(figure, "svg") for figure in drawn.values())


def test_a_window_that_does_not_exist_is_refused(synthetic_result: Result) -> None:
    with pytest.raises(UsageError, match="window 7 is not in the result"):
        draw_figures(synthetic_result, 7)


def test_a_window_without_vehicles_has_no_pictures(synthetic_result: Result) -> None:
    empty = replace(
        with_window(synthetic_result, status="nothing_to_plan"), states=synthetic_result.states.clear()
    )
    assert draw_figures(empty, 0) == {}


def test_names_are_drawn_as_they_are_and_never_break_the_file(synthetic_result: Result) -> None:
    nasty = {"car 1": "<b>$x_1$</b>", "car 2": "_hidden\n\x00\u202e", "car 3": "\u4eba" + "x" * 10_000}
    for name, figure in draw_figures(renamed(synthetic_result, nasty), 0).items():
        root = ET.fromstring(figure_bytes(figure, "svg"))  # noqa: S314
        texts = ["".join(node.itertext()) for node in root.iter() if node.tag.endswith("text")]
        if name == "separation":
            continue
        assert "<b>$x_1$</b>" in texts
        assert any(text.startswith("_hidden\ufffd") for text in texts)
        assert max(map(len, texts)) < 100


def test_drawable_text_is_short_printable_and_never_empty() -> None:
    assert drawable("veh_1") == "veh_1"
    assert len(drawable("v" * 500)) <= 20
    assert drawable("") == "\ufffd"
    assert drawable("a\u202eb\ud800\tc") == "a\ufffdb\ufffd\ufffdc"


def test_far_from_the_origin_the_axes_count_from_a_round_number(synthetic_result: Result) -> None:
    shift = {"x_m": 652_000.0, "y_m": 4_711_000.0}
    states = synthetic_result.states.with_columns(pl.col(name) + by for name, by in shift.items())
    corridors = synthetic_result.corridors.with_columns(
        pl.col(f"frame_{name}") + by for name, by in shift.items()
    )
    scene = window_scene(replace(synthetic_result, states=states, corridors=corridors), 0)
    near = window_scene(synthetic_result, 0)
    assert scene.origin_m == (652_100.0, 4_711_000.0)
    moved = np.array([652_000.0, 4_711_000.0]) - scene.origin_m
    for vehicle, track in near.planned.items():
        np.testing.assert_allclose(scene.planned[vehicle].poses[:, :2], track.poses[:, :2] + moved, atol=1e-6)
        shape = near.corridors[vehicle]
        np.testing.assert_allclose(scene.corridors[vehicle].outlines_m, shape.outlines_m + moved, atol=1e-6)
    svg = figure_bytes(draw_scene(scene)["top_down"], "svg")
    assert b"origin of the axes: x 652100 m, y 4711000 m" in svg


def test_more_vehicles_than_a_page_holds_get_more_pages(synthetic_result: Result) -> None:
    def crowd(table: pl.DataFrame) -> pl.DataFrame:
        ids = pl.col("vehicle_id")
        return pl.concat([table.with_columns((ids + f" of {n}").alias("vehicle_id")) for n in range(4)])

    many = replace(
        synthetic_result, states=crowd(synthetic_result.states), corridors=crowd(synthetic_result.corridors)
    )
    kinds = ("own_corridors", "speed_acceleration")
    drawn = draw_figures(many, 0, only=kinds)
    assert set(drawn) == {"own_corridors", "own_corridors_2", "speed_acceleration"}
    panels = len(drawn["own_corridors"].axes) + len(drawn["own_corridors_2"].axes)
    assert panels == 12
    assert "own_corridors_2" not in draw_scene(window_scene(many, 0), kinds[:1], most_pages=1)


def test_vehicles_with_little_data_are_drawn_without_a_warning(synthetic_result: Result) -> None:
    unknown = ["speed_mps", "acceleration_mps2", "length_m", "width_m"]
    states = synthetic_result.states.with_columns(pl.lit(None, pl.Float64).alias(name) for name in unknown)
    recorded = states.filter(pl.col("source") == "recorded")
    one_each = recorded.group_by("vehicle_id", maintain_order=True).first().select(states.columns)
    for rows in (recorded, one_each, one_each.head(1)):
        for figure in draw_figures(without_plan(replace(synthetic_result, states=rows)), 0).values():
            assert figure_bytes(figure, "svg")


def test_recorded_states_on_a_boundary_belong_to_both_windows(synthetic_result: Result) -> None:
    # The reader gives such a state the later window's number.
    last = pl.col("time_ns") == synthetic_result.states["time_ns"].max()
    recorded = pl.col("source") == "recorded"
    moved = synthetic_result.states.with_columns(
        pl.when(last & recorded).then(1).otherwise("window").cast(pl.Int32).alias("window")
    )
    scene = window_scene(replace(synthetic_result, states=moved), 0)
    assert {track.times_s[-1] for track in scene.recorded.values()} == {6.0}


# --- the closest pair ------------------------------------------------------------------------


def random_tracks(seed: int, vehicles: int, start_s: float = 0.0) -> dict[str, Track]:
    random = np.random.default_rng(seed)
    tracks = {}
    for n in range(vehicles):
        times = np.round(start_s + np.arange(0.0, 4.01, 0.1), 9)
        poses = np.column_stack(
            [
                random.uniform(-15, 15) + random.uniform(-6, 6) * times,
                random.uniform(-15, 15) + random.uniform(-6, 6) * times,
                random.uniform(-3, 3) + random.uniform(-1, 1) * times,
            ]
        )
        nothing = np.full(len(times), np.nan)
        tracks[f"v{n}"] = Track(
            f"v{n}", times, poses, nothing, nothing, random.uniform(1, 6), random.uniform(1, 3)
        )
    return tracks


def outline(track: Track, step: int) -> Polygon:
    x, y, heading = track.poses[step]
    c, s = np.cos(heading), np.sin(heading)
    half = [(1, 1), (1, -1), (-1, -1), (-1, 1)]
    return Polygon(
        (
            x + c * i * track.length_m / 2 - s * j * track.width_m / 2,
            y + s * i * track.length_m / 2 + c * j * track.width_m / 2,
        )
        for i, j in half
    )


@pytest.mark.parametrize("seed", range(4))
def test_the_gap_is_the_least_of_all_pairs(seed: int) -> None:
    tracks = random_tracks(seed, 7)
    pair = closest_pair(tracks)
    assert pair is not None
    for step in range(0, len(pair.times_s), 5):
        distances = [
            outline(a, step).distance(outline(b, step)) for a, b in itertools.combinations(tracks.values(), 2)
        ]
        if min(distances) > 0.0:
            assert pair.gaps_m[step] == pytest.approx(min(distances), abs=1e-9)
        else:
            assert pair.gaps_m[step] <= 0.0
    assert pair.least_m == pair.gaps_m.min()


def test_two_vehicles_that_are_never_there_at_once_have_no_gap() -> None:
    early, late = random_tracks(1, 1), random_tracks(2, 2, start_s=9.0)
    assert closest_pair({"v0": early["v0"], "v1": late["v1"]}) is None
    assert closest_pair(early) is None


def test_no_pose_is_invented_in_a_gap() -> None:
    track = random_tracks(3, 1)["v0"]
    keep = (track.times_s < 1.05) | (track.times_s > 2.95)
    torn = replace(track, times_s=track.times_s[keep], poses=track.poses[keep])
    poses = torn.at(np.array([-0.5, 0.55, 1.0, 2.0, 3.5, 9.0]))
    assert np.isnan(poses[[0, 3, 5]]).all()
    np.testing.assert_allclose(poses[[1, 2, 4]], track.at(np.array([0.55, 1.0, 3.5])))
    times, _ = torn.with_gaps(torn.poses[:, :2])
    assert np.isnan(times).sum() == 1


def test_segments_are_cut_at_the_rectangle() -> None:
    nan = [np.nan, np.nan]
    points = np.array(
        [
            [-5, 1],
            [5, 1],
            nan,
            [0, -9],
            [0, 9],
            nan,
            [3, 3],
            [4, 9],
            nan,
            [1, 1],
            [1.5, 1.5],
            nan,
            [-3, 0],
            [0, 3],
        ]
    )
    cut = clip_segments(points, (-2.0, 2.0), (-2.0, 2.0))
    expected = [[[-2, 1], [2, 1]], [[0, -2], [0, 2]], [[1, 1], [1.5, 1.5]], [[-2, 1], [-1, 2]]]
    np.testing.assert_allclose(cut, expected)
