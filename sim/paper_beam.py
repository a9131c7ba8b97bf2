"""The paper's beam and measured modes (Tables 1 and 2), and a beam that has them.

References
----------
Yoo, Lee, Kim, "Tracking for high-order damping of thin beam oscillation": Table 1 (properties), Table 2 (modes).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from sim.ancf import AncfBeam
from sim.beam import BeamProperties, Orientation, PointMass
from sim.modes import beam_modes

FloatArray = NDArray[np.float64]

MEASURED_FREQUENCY_HZ = (1.85, 10.19, 26.84, 53.20, 88.60)
MEASURED_DAMPING_RATIO = (0.0100, 0.0028, 0.0028, 0.0023, 0.0030)


def paper_beam(orientation: Orientation = "hanging", elements: int = 20) -> BeamProperties:
    """Beam of Table 1's standard column: 500 x 5 x 0.5 mm, 8000 kg/m3, 210 GPa."""
    return BeamProperties.uniform(
        length_m=0.5,
        width_m=5.0e-3,
        thickness_m=0.5e-3,
        density_kg_m3=8000.0,
        elastic_modulus_pa=210.0e9,
        orientation=orientation,
        elements=elements,
    )


def sample_beam(elements: int = 20) -> BeamProperties:
    """Hanging beam whose five frequencies lie within 0.4 % of Table 2.

    The thickness tapers from 0.515 mm at the clamp to 0.450 mm at the tip, a point mass of 0.46 g stands at 359 mm, and
    the modulus is 200 GPa: rounded from what `search_sample_beam` finds.
    """
    return _tapered(np.array([0.515e-3, 0.450e-3, 0.359, 0.46e-3]), elements)


def search_sample_beam(elements: int = 20) -> BeamProperties:
    """Find the taper and point mass with the smallest largest deviation from Table 2's frequencies.

    Four numbers against five frequencies: thickness at clamp and tip, place and size of the mass. About 0.33 % remain.
    """
    start = np.array([0.5146, 0.4503, 0.359, 0.45])
    unit = np.array([1e-3, 1e-3, 1.0, 1e-3])
    steps = np.diag([-0.0016, 0.0017, 0.001, 0.03])

    def deviation(point: FloatArray) -> float:
        frequency = beam_modes(AncfBeam(_tapered(point * unit, elements)), 5).frequency_hz
        return float(np.max(np.abs(frequency / np.array(MEASURED_FREQUENCY_HZ) - 1.0)))

    simplex = np.vstack([start, start + steps])
    found = minimize(
        deviation, start, method="Nelder-Mead", options={"initial_simplex": simplex, "maxiter": 250}
    )
    return _tapered(np.asarray(found.x) * unit, elements)


def _tapered(point: FloatArray, elements: int) -> BeamProperties:
    clamp_m, tip_m, position_m, mass_kg = (float(value) for value in point)
    middle = (np.arange(elements) + 0.5) / elements
    return BeamProperties(
        length_m=0.5,
        width_m=np.full(elements, 5.0e-3),
        thickness_m=clamp_m + (tip_m - clamp_m) * middle,
        density_kg_m3=8000.0,
        elastic_modulus_pa=200.0e9,
        orientation="hanging",
        point_masses=(PointMass(position_m, mass_kg),),
    )
