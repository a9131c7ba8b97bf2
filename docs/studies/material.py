"""Compute the tables of `material.md` and write them: ``python docs/studies/material.py FOLDER``, from the root.

FOLDER is that of the real recordings, with `al_cantilever` and `ordinary` (tests/realdata.tsv).
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT), str(Path(__file__).parent)]

from cantilever import (  # noqa: E402
    DENSITY_KG_M3,
    FROM_TIP_M,
    SENSOR_KG,
    SENSOR_SIDE_M,
    THICKNESS_M,
    WIDTH_M,
    Measured,
    as_markdown,
    mean_of,
    measured,
    modes_in,
    nearest_hz,
)

from modalcam.apps.material import BarMode, Material, Quantity, Specimen, material  # noqa: E402
from sim import MEASURED_FREQUENCY_HZ, sample_beam  # noqa: E402
from sim.beam import BeamProperties, PointMass  # noqa: E402

PAGE = Path(__file__).with_name("material.md")


def strip(length_mm: float, mode_1: Measured, mode_2: Measured) -> Material:
    """E of a strip with the dimensions of its makers; the sensor is a point mass, the orientation is not known."""
    length_m = 1e-3 * length_mm
    sensor = PointMass(length_m - FROM_TIP_M, SENSOR_KG, SENSOR_KG * SENSOR_SIDE_M**2 / 12.0)
    beam = BeamProperties.uniform(
        length_m=length_m, width_m=WIDTH_M, thickness_m=THICKNESS_M, density_kg_m3=DENSITY_KG_M3,
        elastic_modulus_pa=70e9, orientation="none", elements=12, point_masses=(sensor,),
    )  # fmt: skip
    specimen = Specimen(
        "bar",
        length_mm=Quantity(length_mm, 1.0),
        width_mm=Quantity(1e3 * WIDTH_M),
        thickness_mm=Quantity(1e3 * THICKNESS_M, 0.01),
        density_kg_m3=Quantity(DENSITY_KG_M3, 0.005 * DENSITY_KG_M3),
    )
    modes = [BarMode(n, Quantity(m.frequency_hz, m.sd_hz)) for n, m in ((1, mode_1), (2, mode_2))]
    return material(specimen, modes, beam=beam)


def strips(folder: Path) -> dict[float, Material]:
    """The strips of 30, 40 and 50 cm."""
    found = {m.name: m for m in measured(folder / "al_cantilever")}
    runs = [modes_in(folder / "ordinary", f"cantilever_40cm_run{k}.npy", max_modes=2) for k in (1, 2)]
    for number, near in ((1, 9.4), (2, 61.5)):
        name = f"40 cm, mode {number}"
        found[name] = mean_of(name, [nearest_hz(modes, near) for modes in runs])
    return {
        10.0 * cm: strip(10.0 * cm, *(found[f"{cm} cm, mode {n}"] for n in (1, 2))) for cm in (30, 40, 50)
    }


def rows_of_strips(found: dict[float, Material]) -> list[list[str]]:
    rows = [
        [
            "free length / mm",
            "mode",
            "measured / Hz",
            "E / GPa",
            "without the sensor / GPa",
            "90 % interval / GPa",
        ]
    ]
    for length_mm, one in found.items():
        for number in (1, 2):
            e, corrected = (
                next(v for v in one.values if (v.mode, v.quantity) == (number, name))
                for name in ("E", "E_corrected")
            )
            rows.append([
                f"{length_mm:g}", str(number), f"{e.frequency_hz:.3f} ± {e.frequency_sd_hz:.3f}", f"{e.value:.1f}",
                f"{corrected.value:.1f} ± {corrected.sd:.1f}", f"{corrected.q05:.1f} to {corrected.q95:.1f}",
            ])  # fmt: skip
    return rows


def hidden_length(found: dict[float, Material]) -> list[list[str]]:
    """E and the length of bar that is as compliant as the clamp: E of the strips is ``E (1 - 4 x / l)``."""
    rows = [["mode", "E without the clamp / GPa", "clamp as compliant as / mm of bar"]]
    for number in (1, 2):
        key = (number, "E_corrected")
        e = [v.value for one in found.values() for v in one.values if (v.mode, v.quantity) == key]
        slope, at_infinity = np.polyfit([1.0 / length for length in found], e, 1)
        rows.append([str(number), f"{at_infinity:.1f}", f"{-0.25 * slope / at_infinity:.1f}"])
    return rows


def rows_of_samples() -> list[list[str]]:
    """The beam of the samples at its true frequencies, with its mean thickness: 200 GPa, tapered, hanging."""
    true = sample_beam()
    specimen = Specimen(
        "bar",
        length_mm=Quantity(500.0, 0.5),
        width_mm=Quantity(5.0),
        thickness_mm=Quantity(1e3 * float(np.mean(true.thickness_m)), 0.005),
        density_kg_m3=Quantity(8000.0, 40.0),
    )
    modes = [BarMode(n, Quantity(hz, 1e-3 * hz)) for n, hz in enumerate(MEASURED_FREQUENCY_HZ, 1)]
    values = material(specimen, modes, beam=true).values
    rows = [["mode", "Hz", "E / GPa", "without gravity and mass / GPa"]]
    for n, hz in enumerate(MEASURED_FREQUENCY_HZ, 1):
        e, corrected = (v for v in values if v.mode == n)
        rows.append(
            [str(n), f"{hz:g}", f"{e.value:.1f} ± {e.sd:.1f}", f"{corrected.value:.1f} ± {corrected.sd:.1f}"]
        )
    return rows


def main() -> None:
    """Compute the tables and write them into the page."""
    found = strips(Path(sys.argv[1]))
    tables = {"strips": rows_of_strips(found), "clamp": hidden_length(found), "samples": rows_of_samples()}
    text = PAGE.read_text(encoding="utf-8")
    for name, rows in tables.items():
        head, rest = text.split(f"<!-- {name} -->\n", 1)
        tail = rest.split(f"<!-- end of {name} -->", 1)[1]
        text = f"{head}<!-- {name} -->\n{as_markdown(rows)}\n<!-- end of {name} -->{tail}"
    PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
