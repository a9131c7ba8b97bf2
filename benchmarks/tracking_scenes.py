"""The scenes of the tracking benchmark and the measures of a tool's errors in them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tests.support.tracker_scenes import Recording, cramer_rao_px
from tracker.arrays import FloatArray

KINDS = {"aruco": "aruco", "dots": "blob"}
# Motion of 3 px at 11 Hz; the blurred scene moves 10 px in an exposure of 0.9 of the time between frames.
SCENES: dict[str, dict[str, Any]] = {
    "still exposure": {},
    "noise 8": {"read_noise": 8.0},
    "10 px blur": {"amplitude_px": 40.0, "frequency_hz": 44.2, "exposure_s": 0.0009, "turn_rad": 0.02},
}
FILES: dict[str, tuple[str, str, dict[str, int]]] = {
    "lossless": ("ffv1", "mkv", {}),
    "MJPG scale 2": ("mjpeg", "avi", {"quality": 2}),
    "MJPG scale 5": ("mjpeg", "avi", {"quality": 5}),
    "H.264 crf 18": ("libx264", "mp4", {"crf": 18}),
}


def recording_of(kind: str, scene: str, frames: int) -> Recording:
    """A scene with ten 24 px ArUco markers or ten 12 px dots, 640 x 480 px."""
    return Recording(KINDS[kind], frames=frames, **SCENES[scene])


def bound_px(recording: Recording) -> float:
    """Root mean square of the Cramer-Rao bounds of x and y over markers and times."""
    with_angle = recording.kind == "aruco"
    times = [0.0] if not recording.exposure_s else np.linspace(0.0, 1.0 / recording.frequency_hz, 6)[:-1]
    values = [
        cramer_rao_px(recording, k, with_angle=with_angle, time_s=t) for k in range(0, 10, 3) for t in times
    ]
    return float(np.sqrt(np.mean(np.square(values))))


@dataclass(frozen=True)
class Accuracy:
    """How far a tool's positions are from the truth.

    Attributes
    ----------
    rms_px, rms_over_bound : float
        After each marker's mean error is taken away; `rms_over_bound` to the lossless recording's bound.
    error_over_sd : float
        NaN for tools that state no standard deviation.
    amplitude_bias : float
        Slope of the error over the motion.
    locking_px : float
        Amplitude of the error's first harmonic in the fraction of a pixel, less what noise alone gives.
    missing : float
        Share of positions.
    """

    rms_px: float
    rms_over_bound: float
    error_over_sd: float
    amplitude_bias: float
    locking_px: float
    missing: float


def accuracy(
    xy_px: FloatArray, truth_px: FloatArray, bound: float, sd_px: FloatArray | None = None
) -> Accuracy:
    """Measures of positions (n, m, 2), matched to the truth by place, NaN where missing."""
    errors, truths = [], []
    for k in range(xy_px.shape[1]):
        seen = np.flatnonzero(np.all(np.isfinite(xy_px[:, k]), axis=1))
        if seen.size == 0:
            continue
        gap = np.linalg.norm(truth_px[seen[0]] - xy_px[seen[0], k], axis=1)
        truth = truth_px[:, int(np.argmin(gap))]
        error = xy_px[:, k] - truth
        errors.append(error - np.nanmean(error, axis=0))
        truths.append(truth)
    if not errors:
        return Accuracy(*[float("nan")] * 5, 1.0)
    error, truth = np.stack(errors, axis=1), np.stack(truths, axis=1)
    ok = np.isfinite(error)
    motion = truth - truth.mean(axis=0)
    phase = 2 * np.pi * truth[ok]
    first = 2 * np.abs(np.mean(error[ok] * np.exp(1j * phase)))
    rms = float(np.sqrt(np.mean(error[ok] ** 2)))
    by_chance = rms * np.sqrt(np.pi / np.count_nonzero(ok))
    return Accuracy(
        rms_px=rms,
        rms_over_bound=rms / bound,
        error_over_sd=float("nan") if sd_px is None else float(np.sqrt(np.nanmean((error / sd_px) ** 2))),
        amplitude_bias=float(np.sum(motion[ok] * error[ok]) / np.sum(motion[ok] ** 2)),
        locking_px=float(max(first - by_chance, 0.0)),
        missing=1.0 - np.count_nonzero(np.all(ok, axis=2)) / (truth_px.shape[0] * truth_px.shape[1]),
    )
