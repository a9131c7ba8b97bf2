"""The paper's Tables 1 to 3 as printed.

Nothing here is computed, corrected or completed.

References
----------
Yoo, Lee, Kim, "Tracking for high-order damping of thin beam oscillation": Table 1 (properties of the beam), Table 2
(identified modal parameters), Table 3 (natural frequencies: test, standard and optimum). The number of elements, the
bound of the design variables and the statement that the beam stands vertically are from its text.
"""

from __future__ import annotations

from dataclasses import dataclass

from sim.beam import BeamProperties, Orientation
from sim.reference.paper_beam import MEASURED_DAMPING_RATIO, MEASURED_FREQUENCY_HZ


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
