"""The paper's beam and its measured modes (Tables 1 and 2), and a beam with these modes.

References
----------
Yoo, Lee, Kim, "Tracking for high-order damping of thin beam oscillation": Table 1 (properties), Table 2 (modes).
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import root

from sim.beam.ancf import AncfBeam
from sim.beam.modes import beam_modes
from sim.beam.properties import BeamProperties, Orientation, PointMass
from tracker.arrays import FloatArray

MEASURED_FREQUENCY_HZ = (1.85, 10.19, 26.84, 53.20, 88.60)
MEASURED_DAMPING_RATIO = (0.0100, 0.0028, 0.0028, 0.0023, 0.0030)
# relative round-off of an eigenvalue
_REACHED = 1e-7
# m, m, m, m and kg: see `sample_beam`
_SAMPLE = np.array([0.00049249393866, 0.00042643927166, 3.2866122978e-05, 0.3554303221, 0.00041466468958])


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
    """Hanging beam with the five frequencies of Table 2, for 20 elements within 1e-7.

    The thickness decreases as a parabola from 0.492 mm at the clamp to 0.426 mm at the tip, a point mass of 0.41 g is
    at 355 mm, and the modulus is 200 GPa. One of many such beams: see `search_sample_beam`.
    """
    return _tapered(_SAMPLE, elements)


def search_sample_beam(elements: int = 20) -> BeamProperties:
    """Thickness at clamp and tip and its curvature, position and size of the mass from the five frequencies.

    Raises
    ------
    ArithmeticError
        If the frequencies are not reached within 1e-7.
    """
    start = np.array([0.515e-3, 0.450e-3, 0.0, 0.359, 0.46e-3])
    scale = np.array([1e-3, 1e-3, 1e-3, 1.0, 1e-3])

    def deviation(point: FloatArray) -> FloatArray:
        modes = beam_modes(AncfBeam(_tapered(point * scale, elements)), len(MEASURED_FREQUENCY_HZ))
        return np.asarray(modes.frequency_hz / np.array(MEASURED_FREQUENCY_HZ) - 1.0)

    found = root(deviation, start / scale, options={"eps": 1e-8, "xtol": 1e-13})
    if not np.max(np.abs(found.fun)) < _REACHED:
        msg = f"Table 2's frequencies were not reached: relative deviations {found.fun}"
        raise ArithmeticError(msg)
    return _tapered(found.x * scale, elements)


def _tapered(point: FloatArray, elements: int) -> BeamProperties:
    clamp_m, tip_m, bow_m, position_m, mass_kg = (float(value) for value in point)
    middle = (np.arange(elements) + 0.5) / elements
    return BeamProperties(
        length_m=0.5,
        width_m=np.full(elements, 5.0e-3),
        thickness_m=clamp_m + (tip_m - clamp_m) * middle + 4.0 * bow_m * middle * (1.0 - middle),
        density_kg_m3=8000.0,
        elastic_modulus_pa=200.0e9,
        orientation="hanging",
        point_masses=(PointMass(position_m, mass_kg),),
    )
