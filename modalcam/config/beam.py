"""The beam of `experiment.toml`: its keys, their checks, and its properties element by element.

Quantities that cannot be in the unit of their key, such as a length in metres under `length_mm`, are refused.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from modalcam.common import ConfigError
from sim.beam import BeamProperties, ElasticClamp, End, PointMass
from sim.damping import Material
from tracker import Finite, FloatArray, Length, NonNegative, Options, Positive


@dataclass(frozen=True)
class Tuning:
    """Properties beyond which a value is taken to be in another unit, and the mesh of a beam whose section changes."""

    #: [kg/m3] a smaller density is refused
    #: physics: Foams for models begin there.
    least_density: float = 10.0
    #: [kg/m3] a larger density is refused
    #: physics: The densest metals end at 22 600 kg/m3.
    most_density: float = 30_000.0
    #: [MPa] a smaller modulus is refused
    #: physics: Soft rubber has 0.1 MPa.
    least_modulus: float = 1e-3
    #: [MPa] a larger modulus is refused
    #: physics: Diamond has 1.2e6 MPa.
    most_modulus: float = 2e6
    #: [kg/m3] from this density on the modulus is at least `softest_dense`
    #: physics: No material that is denser than light metals is softer.
    dense: float = 2500.0
    #: [MPa] a smaller modulus of a dense material is refused
    #: physics: As for `dense`.
    softest_dense: float = 1000.0
    #: [thicknesses] a shorter beam is refused
    #: physics: It is no thin beam.
    least_length: float = 3.0
    #: [thicknesses] a longer beam is refused
    #: physics: A tape of 1 m and 0.01 mm has 1e5.
    most_length: float = 3e5
    #: [thicknesses] a narrower beam is refused
    #: physics: It bends in the other plane.
    least_width: float = 0.05
    #: [thicknesses] a wider beam is refused
    #: physics: A foil of 0.3 m and 0.01 mm has 3e4.
    most_width: float = 3e4
    #: [length] distance between a change of section and a boundary of elements that is no distance
    #: physics: A frequency changes by as much at most; positions in mm have such digits.
    rounding: float = 1e-5


TUNING = Tuning()


def unit_problems(
    length_mm: float | None,
    width_mm: float | None,
    thickness_mm: float | None,
    density_kg_m3: float | None,
    elastic_modulus_mpa: float | None,
) -> Iterator[str]:
    """Sentences about properties of a beam that cannot be in the units of their keys, with the likely ones."""
    yield from _of_material(density_kg_m3, elastic_modulus_mpa)
    for name, value, (least, most) in (
        ("length_mm", length_mm, (TUNING.least_length, TUNING.most_length)),
        ("width_mm", width_mm, (TUNING.least_width, TUNING.most_width)),
    ):
        if value is None or thickness_mm is None or least <= value / thickness_mm <= most:
            continue
        small, large = (name, "thickness_mm") if value < least * thickness_mm else ("thickness_mm", name)
        size = {name: value, "thickness_mm": thickness_mm}
        yield (
            f"{name} = {value:g} and thickness_mm = {thickness_mm:g} are not those of a beam that bends; if {small} is "
            f"in metres, write {1e3 * size[small]:g}; if {large} is in micrometres, write {1e-3 * size[large]:g}"
        )


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


def _of_material(density_kg_m3: float | None, elastic_modulus_mpa: float | None) -> Iterator[str]:
    if density_kg_m3 is not None and not TUNING.least_density <= density_kg_m3 <= TUNING.most_density:
        unit, factor = ("g/cm3", 1e3) if density_kg_m3 < TUNING.least_density else ("g/m3", 1e-3)
        density_kg_m3, found = factor * density_kg_m3, density_kg_m3
        yield (
            f"density_kg_m3 = {found:g} is that of no material of beams; if it is in {unit}, write {density_kg_m3:g}"
        )
    if elastic_modulus_mpa is None:
        return
    if elastic_modulus_mpa > TUNING.most_modulus:
        yield (
            f"elastic_modulus_mpa = {elastic_modulus_mpa:g} is that of no material; if it is in Pa, write "
            f"{1e-6 * elastic_modulus_mpa:g}"
        )
    dense = density_kg_m3 is not None and density_kg_m3 >= TUNING.dense
    if elastic_modulus_mpa < (TUNING.softest_dense if dense else TUNING.least_modulus):
        yield (
            f"elastic_modulus_mpa = {elastic_modulus_mpa:g} is that of no material"
            f"{f' of {density_kg_m3:g} kg/m3' if dense else ''}; if it is in GPa, write {1e3 * elastic_modulus_mpa:g}"
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
        default=None,
        description="Its thermal properties give the thermoelastic damping.",
        examples=["steel"],
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
    elements: int = Field(default=20, ge=2, le=1000, description="Number of finite elements.")
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
        finer = next((n for n in range(count, 1001) if _boundaries(exact, n) is not None), None)
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
