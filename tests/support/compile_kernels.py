"""Compile most numba kernels: ``python -m support.compile_kernels tracking``, ``line`` or ``beam``.

All other kernels are compiled by the first test that calls them, possibly by two workers.
"""

import sys
import tempfile
from functools import partial
from pathlib import Path

import numpy as np
from support.line_films import SMALL, followed
from support.sim_decays import identification
from support.tracker_scenes import FPS, Recording

from benchmarks.line_scenes import LineScene
from modal_id.identify import fit_free_decay, identify
from sim.beam.ancf import AncfBeam
from sim.beam.modes import beam_modes
from sim.comparison import Candidate, compare_decay
from sim.damping import GenericDamping, RayleighDamping
from sim.reference.paper_beam import MEASURED_DAMPING_RATIO, sample_beam
from tracker.settings import TrackerSettings
from tracker.track import track

POSITIONS_MM = np.array([90.0, 290.0, 490.0])


def tracking():
    """Detect, calibrate and follow dots and ArUco codes, one of them with motion blur."""
    with tempfile.TemporaryDirectory() as name:
        for kind, exposure_s in (("blob", 0.0), ("aruco", 5e-4)):
            recording = Recording(
                kind, frames=150, markers=3, width_px=200, height_px=80, exposure_s=exposure_s
            )
            path = recording.write(Path(name) / f"{kind}.mkv")
            settings = TrackerSettings(fps=FPS, kind=kind, exposure_s=exposure_s or None)
            track(path, settings)


def line():
    """Follow a drawn strip as a line."""
    scene = LineScene(**SMALL)
    followed(scene, scene.frames(6))


def beam():
    """Identify a decay and simulate it with draws of every damping model."""
    modes = beam_modes(AncfBeam(sample_beam()), 5)
    shape = modes.transverse_at(1e-3 * POSITIONS_MM)[:, 0].astype(complex)
    mode = (modes.frequency_hz[0], MEASURED_DAMPING_RATIO[0], shape, 1)
    time_s = np.arange(0.0, 0.7, 1.0 / 200.0)
    found = identification([mode], time_s=time_s, positions_mm=POSITIONS_MM, fit_from_s=0.1)
    generic = GenericDamping(MEASURED_DAMPING_RATIO)
    rayleigh = [
        RayleighDamping.from_modes(
            tuple(modes.omega_rad_s[:2]), MEASURED_DAMPING_RATIO[:2], constant_stiffness=constant
        )
        for constant in (False, True)
    ]
    models = {
        "generic": Candidate(generic, (generic,) * 4),
        "rayleigh": Candidate(rayleigh[0], (rayleigh[0],) * 4),
        "rayleigh_constant_k": Candidate(rayleigh[1], (rayleigh[1],) * 4),
    }
    identify(found.series)
    compare_decay(sample_beam(), found, models, fit=partial(fit_free_decay, max_modes=1))


if __name__ == "__main__":
    {"tracking": tracking, "line": line, "beam": beam}[sys.argv[1]]()
