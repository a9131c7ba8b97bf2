"""Quantities of a beam that cannot be in the unit of their name, such as a length in metres as `length_mm`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass


@dataclass(frozen=True)
class Tuning:
    """Properties beyond which a value is taken to be in another unit."""

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
