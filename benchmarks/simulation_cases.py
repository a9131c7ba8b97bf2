"""Cases of the simulation benchmark: the paper's hanging beam with the paper's damping ratios."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim import MEASURED_DAMPING_RATIO, paper_beam
from sim.beam import AncfBeam, BeamModes, beam_modes
from sim.damping import GenericDamping
from sim.dynamics import HarmonicThenStop, State, released_state, steady_response
from tracker import FloatArray

# Eq. 6 without residual damping; Exudyn uses the same matrix
DAMPING = GenericDamping(MEASURED_DAMPING_RATIO, residual_ratio=0.0)
SAMPLE_S = 4e-3


@dataclass(frozen=True)
class Decay:
    """Release from rest: before the release, the load of the mode holds the tip at its amplitude.

    Both codes are run at all `steps_s`. Errors are evaluated every `sample_s`, a multiple of each of them.
    """

    name: str
    mode_number: int
    tip_m: float
    steps_s: tuple[float, ...]
    sample_s: float = SAMPLE_S
    least_s: float = 0.0

    def state(self, beam: AncfBeam, modes: BeamModes) -> State:
        """State at the start of the decay."""
        return released_state(beam, modes, self.mode_number, self.tip_m)


# The smallest step of each code is its reference. Mode 1 has a period of 0.53 s, of which the decay has to show two.
EQUAL_ERROR = (
    Decay(
        "mode 1, 20 mm", 1, 20e-3, (64e-3, 32e-3, 16e-3, 8e-3, 4e-3, 2e-3, 1e-3, 5e-4, 2e-5), 64e-3, least_s=1.024
    ),
    Decay(
        "mode 3, 1 mm", 3, 1e-3, (6e-3, 4e-3, 3e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4, 5e-5, 2e-5, 1e-5), 12e-3
    ),
    Decay(
        "mode 5, 0.3 mm", 5, 0.3e-3,
        (4e-3, 2e-3, SAMPLE_S / 3, 1e-3, 5e-4, 2e-4, 1e-4, 5e-5, 2.5e-5, 1e-5, 5e-6),
    ),
)  # fmt: skip
PER_STEP = (
    Decay("mode 1, 20 mm", 1, 20e-3, (1e-3, 5e-4, 1e-4)),
    Decay("mode 1, 200 mm", 1, 200e-3, (1e-3, 5e-4, 1e-4)),
)


def beam_and_modes(gauss_points: int = 3) -> tuple[AncfBeam, BeamModes]:
    """The paper's hanging beam with 20 elements, and its modes."""
    beam = AncfBeam(paper_beam(), gauss_points)
    return beam, beam_modes(beam, 8)


def modal_damping_matrix(beam: AncfBeam, modes: BeamModes) -> FloatArray:
    """Eq. 6: ``M Phi diag(2 zeta omega) Phi^T M``, shape (ndof, ndof)."""
    count = len(MEASURED_DAMPING_RATIO)
    columns = beam.mass_matrix() @ modes.phi[:, :count]
    return np.asarray(
        (columns * (2.0 * np.array(MEASURED_DAMPING_RATIO) * modes.omega_rad_s[:count])) @ columns.T
    )


def base_run(modes: BeamModes, *, shake_s: float, tip_m: float = 0.3e-3) -> HarmonicThenStop:
    """Mode 3 driven at resonance from rest, then stopped within a tenth of a period."""
    zeta = DAMPING.coefficients(modes).damping_ratio
    omega = float(modes.omega_rad_s[2])
    tip = modes.transverse_at(np.array([modes.beam.properties.length_m]))[0]
    amplitude = tip_m / abs(complex(tip @ steady_response(modes, zeta, omega)))
    return HarmonicThenStop(amplitude, omega, shake_s, 0.2 * np.pi / omega)


def acceleration_m_s2(motion: HarmonicThenStop, time_s: float) -> float:
    """Acceleration of the base."""
    phase = motion.omega_rad_s * (time_s - motion.stop_s)
    x = min(max((time_s - motion.stop_s) / motion.fade_s, 0.0), 1.0)
    left = 1.0 - x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    d1 = -30.0 * x**2 * (1.0 - x) ** 2 / motion.fade_s
    d2 = -60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / motion.fade_s**2
    w = motion.omega_rad_s
    return float(motion.amplitude_m * ((d2 - left * w**2) * np.sin(phase) + 2.0 * d1 * w * np.cos(phase)))
