"""Quantities that cannot be in the unit of their key, such as a length in metres under `length_mm`."""

from __future__ import annotations

from collections.abc import Sequence

# Foams for models begin at 10 kg/m3, the densest metals end at 22 600.
_DENSITY_KG_M3 = (10.0, 30_000.0)
# Diamond has 1.2e6 MPa, soft rubber 0.1.
_MODULUS_MPA = (1e-3, 2e6)
# No material that is denser than light metals is softer.
_DENSE_KG_M3, _SOFTEST_DENSE_MPA = 2500.0, 1000.0
# Of a thin beam: a tape of 1 m and 0.01 mm has 1e5.
_LENGTH_PER_THICKNESS = (3.0, 3e5)
_WIDTH_PER_THICKNESS = (0.05, 3e4)


def unit_problem(
    length_mm: float | None,
    width_mm: float | None,
    thickness_mm: float | None,
    density_kg_m3: float | None,
    elastic_modulus_mpa: float | None,
) -> str | None:
    """Sentence about a property of a beam that cannot be in the unit of its key, with the likely unit, or None."""
    material = _material(density_kg_m3, elastic_modulus_mpa)
    if material is not None or thickness_mm is None:
        return material
    for name, value, (least, most) in (
        ("length_mm", length_mm, _LENGTH_PER_THICKNESS),
        ("width_mm", width_mm, _WIDTH_PER_THICKNESS),
    ):
        if value is None or least <= value / thickness_mm <= most:
            continue
        small, large = (name, "thickness_mm") if value < least * thickness_mm else ("thickness_mm", name)
        size = {name: value, "thickness_mm": thickness_mm}
        return (
            f"{name} = {value:g} and thickness_mm = {thickness_mm:g} are not those of a beam that bends; if {small} is "
            f"in metres, write {1e3 * size[small]:g}; if {large} is in micrometres, write {1e-3 * size[large]:g}"
        )
    return None


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


def _material(density_kg_m3: float | None, elastic_modulus_mpa: float | None) -> str | None:
    if density_kg_m3 is not None and not _DENSITY_KG_M3[0] <= density_kg_m3 <= _DENSITY_KG_M3[1]:
        unit, factor = ("g/cm3", 1e3) if density_kg_m3 < _DENSITY_KG_M3[0] else ("g/m3", 1e-3)
        return (
            f"density_kg_m3 = {density_kg_m3:g} is that of no material of beams; if it is in {unit}, write "
            f"{factor * density_kg_m3:g}"
        )
    if elastic_modulus_mpa is None:
        return None
    if elastic_modulus_mpa > _MODULUS_MPA[1]:
        return (
            f"elastic_modulus_mpa = {elastic_modulus_mpa:g} is that of no material; if it is in Pa, write "
            f"{1e-6 * elastic_modulus_mpa:g}"
        )
    dense = density_kg_m3 is not None and density_kg_m3 >= _DENSE_KG_M3
    if elastic_modulus_mpa < (_SOFTEST_DENSE_MPA if dense else _MODULUS_MPA[0]):
        return (
            f"elastic_modulus_mpa = {elastic_modulus_mpa:g} is that of no material"
            f"{f' of {density_kg_m3:g} kg/m3' if dense else ''}; if it is in GPa, write {1e3 * elastic_modulus_mpa:g}"
        )
    return None
