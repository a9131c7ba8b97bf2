"""Lines of drawn films, followed frame by frame, with their errors against the truth."""

from dataclasses import dataclass

import numpy as np

from benchmarks.line_scenes import LineScene
from tracker.line import LineFollower, LineModel, calibrate_line
from tracker.template import estimate_noise

# A short line in a small image, so that drawing takes 10 ms a frame.
SMALL = {"length_px": 110.0, "shape": (150, 76), "clamp_px": (38.3, 16.6), "tip_px": (4.0, 1.0)}


@dataclass(frozen=True)
class Followed:
    """Errors across and along the line, stated sd, positions in px, flags; all (frames, stations)."""

    model: LineModel
    arc_px: np.ndarray
    across_px: np.ndarray
    along_px: np.ndarray
    sd_px: np.ndarray
    x_px: np.ndarray
    flags: np.ndarray
    correlation: np.ndarray


def calibrated(scene, frames, **options):
    noise = estimate_noise(frames, white_level=255.0)
    ends = scene.points(0.0, np.array([0.0, scene.length_px]))[0]
    # A hand places them to about a px.
    ends = ends + np.array([[0.8, -0.6], [-0.7, 0.9]])
    camera = np.array([noise.read_variance, noise.gain, 255.0])
    return calibrate_line(frames, ends, camera, exposure_share=scene.exposure, **options)


def followed(scene: LineScene, frames, *, calibration=64, times=None, **options) -> Followed:
    """The line in frames of the scene at `times`, one after another unless given."""
    model = calibrated(scene, frames[:calibration], **options)
    assert model, model.reason
    follower = LineFollower(model)
    results = [follower.step(frame) for frame in frames]
    out = np.stack([r.out for r in results])
    start, normals = scene.points(0.0, np.array([0.0]))
    first = model.line.at_stations(model.start).points[0]
    tangent = np.array([normals[0, 1], -normals[0, 0]])
    # From the clamp of the scene: the ends were not placed exactly.
    arc = model.line.arc_px + (first - start[0]) @ tangent - model.line.arc_px[0]
    across, along = [], []
    for time, values in zip(times if times is not None else range(len(frames)), out, strict=True):
        points, normals = scene.points(float(time), arc)
        normals = normals / np.linalg.norm(normals, axis=1)[:, None]
        off = values[:2].T - points
        across.append(np.sum(off * normals, axis=1))
        along.append(off[:, 0] * normals[:, 1] - off[:, 1] * normals[:, 0])
    sd, marks = np.hypot(out[:, 2], out[:, 3]), np.stack([r.marks for r in results])
    correlation = np.stack([r.correlation for r in results])
    return Followed(model, arc, np.array(across), np.array(along), sd, out[:, 0], marks, correlation)
