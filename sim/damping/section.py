"""What laws without free parameters need to know of a beam: its section, its material and the air."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:
    from sim.beam import BeamProperties


Material = Literal["steel", "stainless_steel", "aluminium", "brass", "copper", "titanium", "silicon"]


@dataclass(frozen=True)
class ThermalMaterial:
    """Thermal properties of a group of alloys at 20 degrees Celsius.

    Attributes
    ----------
    expansion_1_k, conductivity_w_m_k, heat_capacity_j_kg_k : float
        Coefficient of linear expansion, thermal conductivity, specific heat at constant pressure.
    relative_sd : tuple of float
        Of the three: the spread between the grades of a group.
    """

    expansion_1_k: float
    conductivity_w_m_k: float
    heat_capacity_j_kg_k: float
    relative_sd: tuple[float, float, float]


# Handbook values at 20 degrees Celsius, rounded to what the grades of a group have in common.
MATERIALS: dict[Material, ThermalMaterial] = {
    "steel": ThermalMaterial(11.7e-6, 48.0, 470.0, (0.04, 0.10, 0.03)),
    "stainless_steel": ThermalMaterial(16.5e-6, 15.5, 500.0, (0.05, 0.08, 0.03)),
    "aluminium": ThermalMaterial(23.4e-6, 165.0, 900.0, (0.02, 0.20, 0.02)),
    "brass": ThermalMaterial(20.0e-6, 118.0, 380.0, (0.04, 0.08, 0.02)),
    "copper": ThermalMaterial(16.7e-6, 390.0, 385.0, (0.02, 0.05, 0.01)),
    "titanium": ThermalMaterial(8.8e-6, 7.0, 540.0, (0.04, 0.10, 0.04)),
    "silicon": ThermalMaterial(2.6e-6, 149.0, 705.0, (0.03, 0.05, 0.02)),
}


@dataclass(frozen=True)
class BeamSection:
    """Section of a beam, means over its length where they vary, and what surrounds it.

    `material` is None where the configuration names none. The viscosity is that of air at 20 degrees Celsius, which
    does not depend on the pressure.
    """

    width_m: float
    thickness_m: float
    density_kg_m3: float
    elastic_modulus_pa: float
    material: ThermalMaterial | None = None
    air_density_kg_m3: float = 1.204
    air_viscosity_pa_s: float = 1.82e-5
    temperature_k: float = 293.15


def beam_section(
    properties: BeamProperties, material: Material | None = None, air_density_kg_m3: float = 1.204
) -> BeamSection:
    """Section of this beam."""
    return BeamSection(
        float(np.mean(properties.width_m)),
        float(np.mean(properties.thickness_m)),
        properties.density_kg_m3,
        properties.elastic_modulus_pa,
        None if material is None else MATERIALS[material],
        air_density_kg_m3,
    )
