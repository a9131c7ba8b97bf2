"""Compilation of the kernels of the simulation and of synthetic films, so that numba keeps what they need."""

from __future__ import annotations

import numpy as np

from sim.dynamics import simulate_free_decay
from sim.reference import paper_beam
from sim.render import Camera, DotMarker, Poses, Scene, Strip, render_frames
from tracker import FloatArray

_DAMPING_RATIO, _TIP_MM, _DURATION_S, _STEP_S = 0.005, 5.0, 0.01, 5e-4
_WIDTH_PX, _HEIGHT_PX = 64, 48
_DOT_MM = 8.0


def compile_for_simulations() -> None:
    """Compile what the simulation of a decay needs."""
    simulate_free_decay(
        paper_beam(elements=4),
        _DAMPING_RATIO,
        tip_amplitude_mm=_TIP_MM,
        duration_s=_DURATION_S,
        step_s=_STEP_S,
    )


def compile_for_films() -> None:
    """Compile what a synthetic film of a strip with markers needs."""

    def middle(time_s: FloatArray) -> Poses:
        x_mm = np.tile([0.3 * _WIDTH_PX, 0.7 * _WIDTH_PX], (time_s.size, 1))
        return Poses(x_mm, np.full_like(x_mm, -0.5 * _HEIGHT_PX), np.zeros_like(x_mm))

    camera = Camera(width_px=_WIDTH_PX, height_px=_HEIGHT_PX, mm_per_px=1.0, origin_px=(0.0, 0.0))
    strip = Strip(width_mm=0.5 * _DOT_MM, gray=0.5 * camera.background, motion=middle)
    scene = Scene(markers=2 * (DotMarker(diameter_mm=_DOT_MM),), motion=middle, strip=strip)
    for _ in render_frames(scene, camera, np.zeros(1), np.random.default_rng(1)):
        pass
