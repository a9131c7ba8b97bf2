"""Compilation of the kernels of the simulation and of synthetic films, so that numba keeps what they need."""

from __future__ import annotations

import numpy as np

from sim.dynamics import simulate_free_decay
from sim.reference import paper_beam
from sim.render import Camera, DotMarker, Poses, Scene, Strip, render_frames
from tracker import FloatArray


def compile_for_simulations() -> None:
    """Compile what the simulation of a decay needs."""
    simulate_free_decay(paper_beam(elements=4), 0.005, tip_amplitude_mm=5.0, duration_s=0.01, step_s=5e-4)


def compile_for_films() -> None:
    """Compile what a synthetic film of a strip with markers needs."""

    def middle(time_s: FloatArray) -> Poses:
        x_mm = np.tile([0.3 * 64, 0.7 * 64], (time_s.size, 1))
        return Poses(x_mm, np.full_like(x_mm, -0.5 * 48), np.zeros_like(x_mm))

    camera = Camera(width_px=64, height_px=48, mm_per_px=1.0, origin_px=(0.0, 0.0))
    strip = Strip(width_mm=4.0, gray=0.5 * camera.background, motion=middle)
    scene = Scene(markers=2 * (DotMarker(diameter_mm=8.0),), motion=middle, strip=strip)
    for _ in render_frames(scene, camera, np.zeros(1), np.random.default_rng(1)):
        pass
