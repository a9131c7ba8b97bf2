"""What damping models are built from (modes, section, material, air), and what a run and its report know of them."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from sim.damping.law import DampingLaw
from sim.damping.models import DampingModel
from tracker import FloatArray

if TYPE_CHECKING:
    from sim.beam import BeamProperties

_KEY = re.compile(r"[a-z][a-z0-9_]*")
_COLOUR = re.compile(r"#[0-9a-f]{6}")


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


@dataclass(frozen=True)
class MeasuredDamping:
    """Identified modes that damping models are built from, in order of mode number, with posterior draws of each.

    Attributes
    ----------
    numbers : tuple of int
    frequency_hz, damping_ratio : tuple of float
        One per mode.
    frequency_draws_hz, damping_draws : tuple of tuple of float
        Posterior draws, one tuple per mode, all of one length; empty for none.
    damping_sd : tuple of float
        Standard deviations of `damping_ratio`; empty for none.
    section : BeamSection or None
        For laws that are computed from it.
    """

    numbers: tuple[int, ...]
    frequency_hz: tuple[float, ...]
    damping_ratio: tuple[float, ...]
    frequency_draws_hz: tuple[tuple[float, ...], ...] = ()
    damping_draws: tuple[tuple[float, ...], ...] = ()
    damping_sd: tuple[float, ...] = ()
    section: BeamSection | None = None

    def draws(self) -> tuple[MeasuredDamping, ...]:
        """One set of modes per posterior draw."""
        pairs = zip(
            zip(*self.frequency_draws_hz, strict=True), zip(*self.damping_draws, strict=True), strict=True
        )
        drawn = replace(self, frequency_draws_hz=(), damping_draws=())
        return tuple(replace(drawn, frequency_hz=hz, damping_ratio=ratio) for hz, ratio in pairs)


Build = Callable[[MeasuredDamping, FloatArray], DampingModel]


@dataclass(frozen=True)
class DampingModelEntry:
    """A damping model: how it is built from identified modes, and how the report shows it.

    Attributes
    ----------
    key : str
        Name in the configuration and in every table: lower case letters, digits and underscores.
    name : str
        As written in the middle of a sentence.
    description : str
        One sentence.
    colour, dark_colour : str
        Hexadecimal, on a light and on a dark page; unique among the entries.
    build : callable or None
        ``build(measured, omega_rad_s)`` makes the damping object. `omega_rad_s` are the angular frequencies of the
        beam's modes 1 to the highest measured one. None for a model that is fitted to each recording instead and is
        not chosen in ``[damping] models``.
    marker, line_style : str
        Of matplotlib.
    least_modes : int
        Identified modes that `build` needs.
    too_few : str
        Why the model is missing when fewer were identified: the beginning of a sentence.
    draw_stride : int
        1 simulates every posterior draw, 4 every fourth: for a model that is slow to simulate.
    variant_of : str or None
        Key of the model of which this is a variant that differs at large amplitude only: the report draws it only where
        the amplitude is large, and compares it with that model.
    difference : str
        Why a variant differs there, as a sentence of the report.
    law : DampingLaw or None
        The damping ratio over frequency that the model stands for, whose evidence is compared with that of the others.
    """

    key: str
    name: str
    description: str
    colour: str
    dark_colour: str
    build: Build | None
    marker: str = "D"
    line_style: str = ":"
    least_modes: int = 1
    too_few: str = ""
    draw_stride: int = 1
    variant_of: str | None = None
    difference: str = ""
    law: DampingLaw | None = None

    def __post_init__(self) -> None:
        if not _KEY.fullmatch(self.key):
            msg = f"expected a key of lower case letters, digits and underscores, got {self.key!r}"
            raise ValueError(msg)
        for colour in (self.colour, self.dark_colour):
            if not _COLOUR.fullmatch(colour):
                msg = f"damping model {self.key!r}: expected a colour such as '#0067a5', got {colour!r}"
                raise ValueError(msg)
        if self.least_modes < 1 or self.draw_stride < 1:
            msg = f"damping model {self.key!r}: least_modes and draw_stride must be at least 1"
            raise ValueError(msg)

    @property
    def label(self) -> str:
        """The name at the beginning of a line."""
        return self.name[0].upper() + self.name[1:]

    def missing(self, measured: MeasuredDamping) -> str:
        """Why the model cannot be built from these modes: the beginning of a sentence; empty where it can."""
        count = len(measured.numbers)
        if count < self.least_modes:
            return f"{self.too_few or f'{self.label} needs {self.least_modes} identified modes'}; {count} identified"
        if self.law is None or self.build != self.law.model:
            return ""
        positive = "" if min(measured.damping_ratio) > 0.0 else "positive damping ratios"
        lacks = self.law.lacks(measured.section) or positive
        return f"{self.label} needs {lacks}" if lacks else ""


def law_entry(
    key: str, name: str, description: str, colours: tuple[str, str], law: DampingLaw, **others: Any
) -> DampingModelEntry:
    """Entry of a law, with its colours on a light and on a dark page; `others` are fields of the entry."""
    return DampingModelEntry(key, name, description, *colours, build=law.model, law=law, **others)
