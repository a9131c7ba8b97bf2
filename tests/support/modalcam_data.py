"""Marker tracks with values that are difficult to store: NaN, fractions, flags."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
from support.sim_decays import identification

from tracker import NOT_FOUND, DecodeReport, FrameStrip, MarkerTracks, Scale, TimeAxis
from tracker.geometry import Lens, PlaneMap


def sample_tracks():
    rng = np.random.default_rng(1)
    n = 12
    x = 100.0 + rng.normal(size=(n, 2))
    x[2, 1] = np.nan
    flags = np.zeros((n, 2), dtype=np.uint32)
    flags[2, 1] = NOT_FOUND.value
    return MarkerTracks(
        recording="a",
        markers=("m1", "m2"),
        frame=np.arange(n),
        time_s=np.arange(n) / 3.0,
        x_px=x,
        y_px=x + 1,
        sd_x_px=np.full_like(x, 0.01),
        sd_y_px=np.full_like(x, 0.02),
        flags=flags,
        positions_mm=np.array([2.0, np.nan]),
        scale=Scale(0.1, float("nan"), "user"),
        time_axis=TimeAxis("user", Fraction(30000, 1001), None, ("note",)),
        decode=DecodeReport("mjpeg", "gray", 10, 20, 8, n, n, 0, lossy=True),
    )


def rectified_tracks():
    """The same tracks with a lens distortion and an oblique view."""
    lens = Lens(10, 20, (50.0, 50.0), (5.0, 10.0), (-0.01, 0.0, 0.0, 0.0, 0.0))
    plane = PlaneMap((0.2, 0.01, -3.0, 0.0, -0.25, 4.0, 1e-4, 2e-4, 1.0), "from plane_mm")
    strip = FrameStrip(np.array([0, 11]), np.zeros((2, 4, 3), np.uint8), 5.0)
    return replace(sample_tracks(), lens=lens, plane=plane, readout_s=1e-3, strip=strip)


def identification_of(fps):
    """Two modes of three markers, one sample missing."""
    time_s = np.arange(400) / fps
    shapes = [np.array([0.1, 0.5 + 0.01j, 1.0]), np.array([0.3, -0.4, 0.2j])]
    made = identification(
        [(10.19, 0.0028, shapes[0], 2), (26.84, 0.0031, shapes[1], 3)],
        time_s=time_s,
        positions_mm=np.array([10.0, 20.0, 30.0]),
        fit_from_s=0.0,
    )
    values = made.series.values.copy()
    values[7, 2] = np.nan
    return replace(made, series=replace(made.series, values=values))
