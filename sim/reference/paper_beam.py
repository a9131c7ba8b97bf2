"""The paper's beam and its measured modes (Tables 1 and 2), and a beam with these modes.

References
----------
Yoo, Lee, Kim, "Tracking for high-order damping of thin beam oscillation": Table 1 (properties), Table 2 (modes).
"""

from __future__ import annotations

import numpy as np

from sim.beam import BeamProperties, Orientation, PointMass
from tracker import FloatArray

MEASURED_FREQUENCY_HZ = (1.85, 10.19, 26.84, 53.20, 88.60)
MEASURED_DAMPING_RATIO = (0.0100, 0.0028, 0.0028, 0.0023, 0.0030)
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
    at 355 mm, and the modulus is 200 GPa. One of many such beams.
    """
    return tapered_beam(_SAMPLE, elements)


def tapered_beam(point: FloatArray, elements: int) -> BeamProperties:
    """Beam of five numbers: thickness at clamp and tip and its curvature, position and size of a mass (m, kg)."""
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
