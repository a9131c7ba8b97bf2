"""The mean frames of a planned recording: rendered once, exposed again and again."""

from __future__ import annotations

import gzip
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np

from modalcam.planning.request import PlanRequest, decay_length_s
from sim.beam.ancf import AncfBeam
from sim.beam.modes import beam_modes
from sim.damping import GenericDamping
from sim.render.camera import Camera
from sim.render.frames import render_ideal
from sim.render.take import Optics, StagedTake, Take, stage_take
from tracker.arrays import FloatArray

MODES_FILMED = 8
# Steady shaking before the stop, in cycles and seconds.
_SHAKE_CYCLES, _SHAKE_S = 8.0, 0.1
# Float32 holds counts of 16 bit to 0.004 of a count.
_KEPT = np.dtype("<f4")


@dataclass(frozen=True)
class MeanFrames:
    """Frames without noise in a file: every trial of a mode sees the same motion.

    Attributes
    ----------
    path : Path
        Compressed float32 counts, frame after frame.
    camera : Camera
        Cropped to the motion.
    onset_s : float
        Beginning of the stop, from the first frame.
    """

    path: Path
    camera: Camera
    onset_s: float

    def read(self) -> Iterator[FloatArray]:
        """Yield each frame, shape (height_px, width_px)."""
        shape = (self.camera.height_px, self.camera.width_px)
        size = _KEPT.itemsize * shape[0] * shape[1]
        with gzip.open(self.path) as file:
            while chunk := file.read(size):
                yield np.frombuffer(chunk, dtype=_KEPT).reshape(shape).astype(np.float64)


def film_means(request: PlanRequest, index: int, path: Path) -> MeanFrames | str:
    """Simulate and film the request's mode with this index; a reason where it cannot be simulated."""
    mode, camera = request.modes[index], request.camera
    frequency = float(beam_modes(AncfBeam(request.beam), mode.number).frequency_hz[-1])
    found = stage_take(
        request.beam,
        GenericDamping((mode.damping_ratio,) * mode.number),
        Take(
            mode_number=mode.number,
            tip_amplitude_m=1e-3 * mode.tip_amplitude_mm,
            shake_s=max(_SHAKE_S, _SHAKE_CYCLES / frequency),
            decay_s=decay_length_s(mode, frequency),
        ),
        Optics(
            fps=Fraction(request.fps),
            mm_per_px=camera.mm_per_px,
            exposure_s=camera.exposure_s,
            lens_blur_px=camera.lens_blur_px,
            read_noise_sd=camera.read_noise_sd,
            noise_gain=camera.noise_gain,
            background=camera.background,
            bit_depth=camera.bit_depth,
        ),
        prints=request.prints,
        positions_m=1e-3 * np.array(request.positions_mm),
        mode_count=max(MODES_FILMED, mode.number + 1),
    )
    if not isinstance(found, StagedTake):
        return f"the simulation stopped at {found.time_s:.6g} s: {found.reason}"
    with gzip.open(path, "wb", compresslevel=1) as file:
        for image in render_ideal(found.scene, found.camera, found.frame_times_s):
            file.write(image.astype(_KEPT).tobytes())
    return MeanFrames(path, found.camera, found.onset_s)
