"""Distributions as pictures: bars of equal width, linear or by decades."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import polars as pl
from numpy.typing import NDArray

from istc_replay.datatypes import FloatArray
from istc_replay.export.report.markup import Html, element, join, number

_WIDTH, _HEIGHT, _LEFT, _RIGHT, _TOP, _BOTTOM = 420, 170, 44, 10, 10, 34
_BINS = 24


@dataclass(frozen=True, slots=True)
class Distribution:
    """A quantity over all logs: its `values` (null: not judged), and what they are in words.

    `span` bounds the bars, what lies outside is in the first and the last; `log` spaces them by
    decades.
    """

    title: str
    unit: str
    values: pl.Series
    detail: str
    span: tuple[float, float] | None = None
    log: bool = False
    digits: int = 2


def histogram(told: Distribution) -> Html:
    """Draw a distribution, with its count, median and tails in words."""
    values = told.values.drop_nulls().cast(pl.Float64)
    values = values.filter(values.is_finite())
    missing = len(told.values) - len(values)
    unit = f" [{told.unit}]" if told.unit else ""
    title = element("h3", told.title + unit)
    if values.is_empty():
        none = "No value was judged." if len(told.values) else "There is none."
        return element("figure", title, element("p", none), element("figcaption", told.detail), class_="part")
    array = values.to_numpy()
    edges = _edges(array, told)
    counts, _ = np.histogram(np.clip(array, edges[0], edges[-1]), edges)
    low, middle, high = (number(float(value), told.digits) for value in np.quantile(array, (0.05, 0.5, 0.95)))
    words = f"{len(values)} values; median {middle}, 5 % below {low}, 5 % above {high}"
    if missing:
        words += f"; {missing} without one"
    clipped = int(((array < edges[0]) | (array > edges[-1])).sum())
    if clipped:
        words += f"; {clipped} beyond the bars are in the outer ones"
    return element(
        "figure",
        title,
        _picture(counts, edges, told, f"{told.title}: {words}"),
        element("figcaption", f"{words}. {told.detail}"),
        class_="part",
    )


def _edges(array: FloatArray, told: Distribution) -> FloatArray:
    if told.log:
        least = float(array[array > 0.0].min(initial=1.0))
        first = math.floor(math.log10(max(least, 1e-9)))
        last = max(first + 1, math.ceil(math.log10(max(float(array.max()), 1e-9))))
        count = 1 + (last - first) * max(2, _BINS // (last - first))
        return np.logspace(first, last, count, dtype=np.float64)
    low, high = told.span or (float(np.quantile(array, 0.005)), float(np.quantile(array, 0.995)))
    if high - low < 1e-9:
        low, high = low - 0.5, high + 0.5
    step = _nice((high - low) / _BINS)
    whole = np.arange(math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9) + 1, dtype=np.float64)
    return whole * step


def _nice(step: float) -> float:
    """The next of 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(step))
    return next(m * power for m in (1.0, 2.0, 5.0, 10.0) if m * power >= step * (1 - 1e-9))


def _picture(counts: NDArray[np.int64], edges: FloatArray, told: Distribution, words: str) -> Html:
    place = np.log10(edges) if told.log else edges
    x = _LEFT + (place - place[0]) / (place[-1] - place[0]) * (_WIDTH - _LEFT - _RIGHT)
    most = int(counts.max())
    tall = _HEIGHT - _TOP - _BOTTOM
    bars = [
        element(
            "rect",
            element("title", f"{_tick(edges[i], told)} to {_tick(edges[i + 1], told)}: {count}"),
            x=f"{x[i] + 0.5:.1f}",
            y=f"{_TOP + tall * (1 - count / most):.1f}",
            width=f"{max(x[i + 1] - x[i] - 1, 0.5):.1f}",
            height=f"{tall * count / most:.1f}",
            fill="var(--link)",
        )
        for i, count in enumerate(counts)
        if count
    ]
    marks = _marks(edges, told)
    ticks = [
        element(
            "text",
            _tick(edges[i], told),
            x=f"{x[i]:.1f}",
            y=str(_HEIGHT - 16),
            text_anchor="middle",
            font_size="12",
            fill="var(--muted)",
        )
        for i in marks
    ]
    floor = str(_TOP + tall)
    base = element("line", x1=str(_LEFT), x2=str(_WIDTH - _RIGHT), y1=floor, y2=floor, stroke="var(--muted)")
    text = {"font_size": "12", "fill": "var(--muted)", "text_anchor": "end"}
    top = element("text", str(most), x=str(_LEFT - 6), y=str(_TOP + 10), **text)
    inner = join([*bars, base, top, *ticks])
    return element("svg", inner, viewBox=f"0 0 {_WIDTH} {_HEIGHT}", role="img", aria_label=words)


def _marks(edges: FloatArray, told: Distribution) -> list[int]:
    """The edges that are labelled: whole decades, or about five."""
    if told.log:
        whole = [i for i, edge in enumerate(edges) if abs(math.log10(edge) - round(math.log10(edge))) < 1e-6]
        return whole[:: max(1, len(whole) // 6)]
    every = max(1, round((len(edges) - 1) / 5))
    return list(range(0, len(edges), every))


def _tick(value: float, told: Distribution) -> str:
    text = f"{value:.0e}" if told.log and (value < 0.01 or value >= 1000) else f"{round(float(value), 9):g}"
    return text.replace("e-0", "e-").replace("e+0", "e").replace("-", "−")
