"""Marker tracks made of positions, and tracks with values that are difficult to store: NaN, fractions, flags."""

from dataclasses import replace
from fractions import Fraction

import numpy as np

from tracker import NOT_FOUND, DecodeReport, FrameStrip, MarkerTracks, Scale, TimeAxis
from tracker.geometry import Lens, PlaneMap


def decoded(frames, *, codec="ffv1", pixel_format="gray", size=(640, 480), lossy=False, **more):
    """Report of a film of which every frame was decoded."""
    return DecodeReport(codec, pixel_format, *size, 8, frames, frames, 0, lossy=lossy, **more)


def tracks_of(x_px, y_px=50.0, *, fps=1000, sd_px=0.01, **more):
    """Tracks of these positions, (frames, markers); `more` are other fields of the tracks."""
    x, y = (np.array(part) for part in np.broadcast_arrays(np.asarray(x_px, dtype=float), y_px))
    n, m = x.shape
    given = {
        "recording": "r",
        "markers": tuple(f"m{k + 1}" for k in range(m)),
        "frame": np.arange(n),
        "time_s": np.arange(n) / fps,
        "sd_x_px": np.full((n, m), sd_px),
        "sd_y_px": np.full((n, m), sd_px),
        "flags": np.zeros((n, m), np.uint32),
        "positions_mm": np.full(m, np.nan),
        "scale": None,
        "time_axis": TimeAxis("user", Fraction(fps)),
        "decode": decoded(n),
    }
    return MarkerTracks(x_px=x, y_px=y, **(given | more))


def sample_tracks():
    x = 100.0 + np.random.default_rng(1).normal(size=(12, 2))
    x[2, 1] = np.nan
    flags = np.zeros((12, 2), dtype=np.uint32)
    flags[2, 1] = NOT_FOUND.value
    return tracks_of(
        x,
        x + 1,
        fps=3.0,
        recording="a",
        sd_y_px=np.full_like(x, 0.02),
        flags=flags,
        positions_mm=np.array([2.0, np.nan]),
        scale=Scale(0.1, float("nan"), "user"),
        time_axis=TimeAxis("user", Fraction(30000, 1001), None, ("note",)),
        decode=decoded(12, codec="mjpeg", size=(10, 20), lossy=True),
    )


def rectified_tracks():
    """The same tracks with a lens distortion and an oblique view."""
    lens = Lens(10, 20, (50.0, 50.0), (5.0, 10.0), (-0.01, 0.0, 0.0, 0.0, 0.0))
    plane = PlaneMap((0.2, 0.01, -3.0, 0.0, -0.25, 4.0, 1e-4, 2e-4, 1.0), "from plane_mm")
    strip = FrameStrip(np.array([0, 11]), np.zeros((2, 4, 3), np.uint8), 5.0)
    return replace(sample_tracks(), lens=lens, plane=plane, readout_s=1e-3, strip=strip)
