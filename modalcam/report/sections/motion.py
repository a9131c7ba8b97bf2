"""Mode shapes in motion: each between its extremes, by the style sheet alone."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from modalcam.report.figures import MOST_POINTS, RecordingSubject, shape_of
from tracker import FloatArray

# Length of the beam and largest amplitude, in the units of the drawing.
LENGTH, AMPLITUDE = 200.0, 28.0


class MovingShape(NamedTuple):
    """A mode shape at one extreme: y is down, the beam at rest lies on y = 0 from the clamp at x = 0.

    `points` are the markers; of many, such as the stations of a line, `measured` is the path instead. Paths are empty
    where there is none.
    """

    points: tuple[tuple[float, float], ...]
    measured: str
    theory: str


def moving_shape(subject: RecordingSubject) -> MovingShape | None:
    """Shape of the mode shown, its component in phase; None where it has no shape."""
    shown = shape_of(subject)
    if shown is None:
        return None
    at, real = shown.position_mm, shown.shape.real
    theory_at, theory = (np.empty(0), np.empty(0)) if shown.curve is None else shown.curve
    longest = float(np.max(np.concatenate((at, theory_at))))
    largest = float(np.max(np.abs(np.concatenate((real, theory)))))
    if not (longest > 0.0 and largest > 0.0):
        return None
    x, y = LENGTH * at / longest, -AMPLITUDE * real / largest
    many = at.size > MOST_POINTS
    return MovingShape(
        points=()
        if many
        else tuple((round(float(a), 1), round(float(b), 1)) for a, b in zip(x, y, strict=True)),
        measured=_path(x, y) if many else "",
        theory=_path(LENGTH * theory_at[::3] / longest, -AMPLITUDE * theory[::3] / largest),
    )


def _path(x: FloatArray, y: FloatArray) -> str:
    return "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(x, y, strict=True)) if x.size else ""
