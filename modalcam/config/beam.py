"""The beam of `experiment.toml`: its keys, their checks, and its properties element by element."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from modalcam.common import ConfigError
from sim.beam import BeamProperties, ElasticClamp, End, PointMass, unit_problems
from sim.damping import Material
from tracker import Finite, FloatArray, Length, NonNegative, Options, Positive


@dataclass(frozen=True)
class Tuning:
    """The mesh of a beam whose section changes."""

    #: [length] distance between a change of section and a boundary of elements that is no distance
    #: physics: A frequency changes by as much at most; positions in mm have such digits.
    rounding: float = 1e-5


TUNING = Tuning()


def position_problem(positions_mm: Sequence[float], length_mm: float) -> str | None:
    """Sentence about a marker that lies beyond the end of the beam, with the likely unit, or None."""
    furthest = max(positions_mm, default=0.0)
    if furthest <= length_mm:
        return None
    likely = f"; if length_mm is in metres, write {1e3 * length_mm:g}" if furthest > 30.0 * length_mm else ""
    return (
        f"markers.positions_mm: a marker at {furthest:g} mm from the clamp lies beyond the end of the beam "
        f"(beam.length_mm = {length_mm:g}){likely}"
    )


class PointMassConfig(Options):
    """Mass fixed to the beam, such as a sensor or a marker; one table per mass."""

    position_mm: NonNegative = Field(description="Distance from the clamp.", examples=[440.0])
    mass_g: Positive = Field(description="Mass.", examples=[0.4])
    rotary_inertia_g_mm2: NonNegative = Field(
        default=0.0, description="Rotary inertia about the axis of bending.", examples=[2.0]
    )


class ClampConfig(Options):
    """Elastic clamp; without this section the clamp is rigid."""

    rotation_n_m_rad: Positive = Field(description="Rotational stiffness.", examples=[300.0])
    translation_n_m: Positive | None = Field(
        default=None,
        description="Translational stiffness; rigid against translation when not given.",
        examples=[1e6],
    )


class SectionConfig(Options):
    """Change of section; one table per position from which on the beam has another width or thickness than `[beam]`."""

    from_mm: Positive = Field(
        description="Distance from the first end: a boundary of elements. The section is that of this table up to the "
        "next one.",
        examples=[400.0],
    )
    width_mm: Length | None = Field(
        default=None, description="Width; of [beam] when not given.", examples=[10.0]
    )
    thickness_mm: Length | None = Field(
        default=None, description="Thickness; of [beam] when not given.", examples=[1.0]
    )


_MOST_ELEMENTS = 1000
REQUIRED_OF_BEAM = ("length_mm", "width_mm", "thickness_mm", "density_kg_m3", "elastic_modulus_mpa")


class BeamConfig(Options):
    """Beam: geometry, material and mounting. Without this section nothing is simulated."""

    length_mm: Length | None = Field(default=None, description="Free length, clamp to tip.", examples=[500.0])
    length_sd_mm: NonNegative | None = Field(default=None, description="Its sd.", examples=[0.5])
    width_mm: Length | None = Field(default=None, description="Width of the cross-section.", examples=[5.0])
    thickness_mm: Length | None = Field(
        default=None,
        description="Thickness of the cross-section, in the direction of bending.",
        examples=[0.5],
    )
    thickness_sd_mm: NonNegative | None = Field(default=None, description="Sd of its mean.", examples=[0.005])
    density_kg_m3: Positive | None = Field(default=None, description="Mass density.", examples=[8000.0])
    density_sd_kg_m3: NonNegative | None = Field(default=None, description="Its sd.", examples=[40.0])
    elastic_modulus_mpa: Positive | None = Field(
        default=None, description="Young's modulus.", examples=[210000.0]
    )
    material: Material | None = Field(
        default=None, description="Its thermal properties give the thermoelastic damping.", examples=["steel"]
    )
    orientation: Literal["hanging", "standing", "horizontal", "angled", "none"] = Field(
        default="hanging",
        description='Direction of the undeformed beam against gravity; "horizontal" bends under its weight, "none" '
        'neglects gravity, "angled" needs angle_deg.',
    )
    angle_deg: Finite | None = Field(
        default=None,
        description='Angle from hanging, counter-clockwise, for orientation "angled".',
        examples=[30.0],
    )
    elements: int = Field(default=20, ge=2, le=_MOST_ELEMENTS, description="Number of finite elements.")
    sections: tuple[SectionConfig, ...] = Field(default=(), description="Changes of section.")
    point_masses: tuple[PointMassConfig, ...] = Field(default=(), description="Masses fixed to the beam.")
    clamp: ClampConfig | None = Field(default=None, description="Elastic clamp.")
    ends: tuple[End, End] = Field(
        default=("clamped", "free"),
        description="First end, from which positions count, and second end: clamped; pinned (may rotate); guided (may "
        "move across); free. Along the beam all but free ends are held.",
        examples=[["pinned", "pinned"]],
    )
    tension_n: Finite = Field(
        default=0.0,
        description="Axial force of the straight beam without weight, positive in tension; no end may be free.",
        examples=[20.0],
    )

    @model_validator(mode="after")
    def _angle_belongs_to_angled(self) -> BeamConfig:
        if (self.orientation == "angled") != (self.angle_deg is not None):
            msg = (
                'orientation = "angled" needs angle_deg (from hanging, counter-clockwise), and no other orientation '
                f"takes it; found orientation = {self.orientation!r} and angle_deg = {self.angle_deg}"
            )
            raise ValueError(msg)
        return self

    @model_validator(mode="after")
    def _in_the_units_of_the_keys(self) -> BeamConfig:
        found: list[str] = []
        for one in (None, *self.sections):
            found += unit_problems(
                self.length_mm, *self.section(one), self.density_kg_m3, self.elastic_modulus_mpa
            )
        if found:
            raise ValueError("; ".join(dict.fromkeys(found)))
        return self

    def section(self, change: SectionConfig | None) -> tuple[float | None, float | None]:
        """Width and thickness in mm from a change of section on, or from the first end."""
        width, thickness = (change.width_mm, change.thickness_mm) if change else (None, None)
        return width or self.width_mm, thickness or self.thickness_mm

    def missing(self) -> tuple[str, ...]:
        """Keys that a simulation needs and that are not given."""
        return tuple(key for key in REQUIRED_OF_BEAM if getattr(self, key) is None)


def beam_properties(beam: BeamConfig | None) -> BeamProperties | str:
    """The beam as configured, or a sentence about what a simulation lacks; ConfigError for contradictions."""
    if beam is None:
        return "There is no [beam] in the configuration, so nothing was simulated, and mode numbers were not checked."
    missing = beam.missing()
    if missing:
        keys = ", ".join(f"beam.{key}" for key in missing)
        return f"The beam was not simulated: {keys} not given in the configuration."
    required = {key: getattr(beam, key) for key in REQUIRED_OF_BEAM}
    masses = tuple(
        PointMass(
            position_m=m.position_mm * 1e-3,
            mass_kg=m.mass_g * 1e-3,
            rotary_inertia_kg_m2=m.rotary_inertia_g_mm2 * 1e-9,
        )
        for m in beam.point_masses
    )
    clamp = None
    if beam.clamp is not None:
        clamp = ElasticClamp(beam.clamp.rotation_n_m_rad, beam.clamp.translation_n_m)
    try:
        width_mm, thickness_mm = _of_elements(beam)
        return BeamProperties(
            length_m=required["length_mm"] * 1e-3,
            width_m=width_mm * 1e-3,
            thickness_m=thickness_mm * 1e-3,
            density_kg_m3=required["density_kg_m3"],
            elastic_modulus_pa=required["elastic_modulus_mpa"] * 1e6,
            orientation=beam.orientation,
            point_masses=masses,
            angle_deg=beam.angle_deg,
            clamp=clamp,
            ends=beam.ends,
            tension_n=beam.tension_n,
        )
    except ValueError as error:
        msg = f"[beam]: {error}"
        raise ConfigError(msg) from error


def _of_elements(beam: BeamConfig) -> tuple[FloatArray, FloatArray]:
    """Width and thickness of each element in mm; ValueError for a change of section that is no boundary of elements."""
    starts_mm, count = [one.from_mm for one in beam.sections], beam.elements
    length_mm = beam.length_mm or 0.0
    if starts_mm != sorted(set(starts_mm)) or any(start >= length_mm for start in starts_mm):
        msg = (
            "sections: expected from_mm in rising order, below the length of the beam "
            f"({length_mm:g} mm); found {', '.join(f'{start:g}' for start in starts_mm)}"
        )
        raise ValueError(msg)
    exact = np.array(starts_mm) / length_mm
    first = _boundaries(exact, count)
    if first is None:
        finer = next((n for n in range(count, _MOST_ELEMENTS + 1) if _boundaries(exact, n) is not None), None)
        off = next(start for start in starts_mm if _boundaries(np.array([start]) / length_mm, count) is None)
        size = length_mm / count
        msg = (
            f"sections: from_mm = {off:g} is no boundary of the {count} elements of {size:g} mm each; write "
            f"{size * round(off / size):g}{f', or elements = {finer}' if finer else ''}"
        )
        raise ValueError(msg)
    width, thickness = np.full(count, beam.width_mm), np.full(count, beam.thickness_mm)
    for start, one in zip(first, beam.sections, strict=True):
        width[start:], thickness[start:] = (
            one.width_mm or beam.width_mm,
            one.thickness_mm or beam.thickness_mm,
        )
    return width, thickness


def _boundaries(positions: FloatArray, elements: int) -> NDArray[np.int64] | None:
    """Element that begins at each position in lengths of the beam; None if one is no boundary, or two share one."""
    first = np.rint(positions * elements).astype(np.int64)
    distance = np.max(np.abs(first / elements - positions), initial=0.0)
    distinct = np.unique(first).size == first.size and np.all((first > 0) & (first < elements))
    return first if distance <= TUNING.rounding and distinct else None
