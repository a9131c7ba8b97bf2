"""The paper's beam and its Tables 1 to 3 as printed: nothing in the tables is computed, corrected or completed.

References
----------
Yoo, Lee, Kim, "Tracking for high-order damping of thin beam oscillation": Table 1 (properties of the beam), Table 2
(identified modal parameters), Table 3 (natural frequencies: test, standard and optimum). The number of elements, the
bound of the design variables and the statement that the beam stands vertically are from its text.
"""

from __future__ import annotations

from dataclasses import dataclass

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


@dataclass(frozen=True)
class PrintedProperties:
    """One row of Table 1, in its own units."""

    length_mm: float
    width_mm: float
    thickness_mm: float
    density_kg_m3: float
    elastic_modulus_mpa: float

    def beam(self, orientation: Orientation, *, density_kg_m3: float | None = None) -> BeamProperties:
        """The uniform beam of the paper's 20 elements that the row describes, with another density if one is given."""
        return BeamProperties.uniform(
            length_m=1e-3 * self.length_mm,
            width_m=1e-3 * self.width_mm,
            thickness_m=1e-3 * self.thickness_mm,
            density_kg_m3=self.density_kg_m3 if density_kg_m3 is None else density_kg_m3,
            elastic_modulus_pa=1e6 * self.elastic_modulus_mpa,
            orientation=orientation,
            elements=ELEMENTS,
        )


ELEMENTS = 20
# Of every design variable, relative to the standard column.
VARIABLE_BOUND = 0.10

TABLE_1_STANDARD = PrintedProperties(500.0, 5.0, 0.50, 8000.0, 210_000.0)
TABLE_1_OPTIMUM = PrintedProperties(500.0, 5.0, 0.49, 8108.0, 205_130.0)

TABLE_2_FREQUENCY_HZ = MEASURED_FREQUENCY_HZ
TABLE_2_DAMPING_RATIO = MEASURED_DAMPING_RATIO

TABLE_3_TEST_HZ = TABLE_2_FREQUENCY_HZ
TABLE_3_STANDARD_HZ = (1.67, 10.47, 29.32, 57.46, 94.97)
TABLE_3_OPTIMUM_HZ = (1.84, 10.18, 26.81, 53.15, 88.79)

# Half of the last digit printed: what a printed value leaves open.
FREQUENCY_ROUNDING_HZ = 0.005
DAMPING_ROUNDING = 0.5e-4
