"""Values of beam, simulation, fit, posterior and registration, as JSON: ``python -m support.numerical_values FILE``.

Each is divided by what its group is compared in, see `support.other_processors`.
"""

import json
import sys
import tempfile
from pathlib import Path

import numpy as np
from kit.scenes import FPS, Recording
from kit.series import pole_of, series_of

from modal_id import identify
from modal_id.data import prepare
from modal_id.fit import find_modes
from modal_id.solve import damping_ratio, frequency_hz
from sim import MEASURED_DAMPING_RATIO, paper_beam, sample_beam
from sim.beam import AncfBeam, beam_modes
from sim.damping import GenericDamping
from sim.dynamics import released_state, simulate
from tracker import TrackerSettings, track

ALONG_M = np.linspace(0.05, 0.5, 10)


def beam():
    """Frequencies of straight and bent beams, over rounded values, and shapes over their largest displacement."""
    straight = [beam_modes(AncfBeam(b), 5) for b in (paper_beam("hanging", 40), sample_beam(20))]
    bent = beam_modes(AncfBeam(paper_beam("horizontal")), 5).frequency_hz
    relative = [m.frequency_hz / np.array([float(f"{x:.4g}") for x in m.frequency_hz]) for m in straight]
    shapes = [m.transverse_at(ALONG_M) for m in straight]
    return (
        np.concatenate(relative),
        bent / np.array([float(f"{x:.4g}") for x in bent]),
        np.concatenate([(s / np.abs(s).max(axis=0)).ravel() for s in shapes]),
    )


def simulation():
    """A second of the third mode with large rotations."""
    assembled = AncfBeam(paper_beam())
    modes = beam_modes(assembled, 8)
    trajectory = simulate(
        assembled, GenericDamping(MEASURED_DAMPING_RATIO), state=released_state(assembled, modes, 3, 5e-3),
        duration_s=0.5, step_s=5e-4, output_positions_m=ALONG_M, modes=modes,
    )  # fmt: skip
    return trajectory.transverse_m / np.abs(trajectory.transverse_m).max()


def identification():
    """Two modes of a noisy record: their fit, and mean and standard deviation of the posterior by sampling."""
    rng = np.random.default_rng(11)
    time_s = np.arange(1500) / 500.0
    shapes = np.array([[0.3, 0.6, 1.0], [0.5, 0.4, -0.4]])
    waves = np.exp(time_s[:, np.newaxis] * np.array([pole_of(10.19, 0.0028), pole_of(26.84, 0.0028)]))
    values = np.real(waves @ shapes) + 0.01 * rng.standard_normal((1500, 3))
    series = series_of(time_s, values)
    poles = find_modes(prepare(series).data, 4).fit.poles
    fits, posteriors = [], []
    for mode, pole in zip(identify(series).modes, poles, strict=True):
        posterior, (frequency_sd, ratio_sd) = mode.posterior, mode.posterior.laplace_sd
        fits += [frequency_hz(pole) / frequency_sd, damping_ratio(pole) / ratio_sd]
        for draws, sd in ((posterior.frequency_hz, frequency_sd), (posterior.damping_ratio, ratio_sd)):
            posteriors += [np.mean(draws) / sd, np.std(draws) / sd]
    return fits, posteriors


def registration():
    """Positions of ArUco codes and of dots of which some are blurred by motion, px."""
    positions = []
    with tempfile.TemporaryDirectory() as name:
        for kind, exposure_s in (("blob", 5e-4), ("aruco", 0.0)):
            recording = Recording(
                kind, frames=60, markers=3, width_px=200, height_px=80, exposure_s=exposure_s
            )
            path = recording.write(Path(name) / f"{kind}.mkv")
            found = track(path, TrackerSettings(fps=FPS, kind=kind, exposure_s=exposure_s or None))
            positions += [found.x_px.ravel(), found.y_px.ravel()]
    return np.concatenate(positions)


def values():
    """All groups, in the order of `support.other_processors.TOLERANCE`."""
    straight, bent, shapes = beam()
    fits, posteriors = identification()
    return {
        "beam: relative frequency": straight,
        "beam bent by its weight: relative frequency": bent,
        "beam: shape over its largest value": shapes,
        "simulation: displacement over the largest": simulation().ravel(),
        "fit: frequency and damping in standard deviations": fits,
        "posterior: mean and standard deviation, in standard deviations": posteriors,
        "registration: px": registration(),
    }


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(json.dumps({k: list(map(float, v)) for k, v in values().items()}))
