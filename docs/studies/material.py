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
    modes_in,
    rows_of,
)

from modal_id.modes import combine  # noqa: E402
from modalcam.apps.material import BarMode, Material, Quantity, Specimen, material  # noqa: E402
from sim import MEASURED_FREQUENCY_HZ, sample_beam  # noqa: E402
from sim.beam import BeamProperties, PointMass  # noqa: E402

__all__ = ["Measured", "rows_of"]
PAGE = Path(__file__).with_name("material.md")


# Assumed: a ruler, a caliper's last digit of 0.01 mm, and a handbook's density.
LENGTH_SD_MM, THICKNESS_SD, DENSITY_SD = 1.0, 0.01 / 2.03, 0.005


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
        length_mm=Quantity(length_mm, LENGTH_SD_MM),
        width_mm=Quantity(1e3 * WIDTH_M),
        thickness_mm=Quantity(1e3 * THICKNESS_M, 1e3 * THICKNESS_M * THICKNESS_SD),
        density_kg_m3=Quantity(DENSITY_KG_M3, DENSITY_SD * DENSITY_KG_M3),
    )
    modes = [BarMode(n, Quantity(m.frequency_hz, m.sd_hz)) for n, m in ((1, mode_1), (2, mode_2))]
    return material(specimen, modes, beam=beam)


# Free length in cm and mode: what the mode is near, the recordings, and the options of `modes_in`. Mode 2 has decayed
# after some seconds; at 30 cm the sensor is near its node, and only one recording shows it.
LATE = {"max_modes": 2}
RECORDINGS = {
    (30, 1): (16.3, ("30cm*21-08-55*", "30cm*21-12-02*", "30cm*21-13-02*"), {"max_modes": 1}),
    (30, 2): (108.0, ("30cm*21-13-02*",), {"between_s": (0.1, 0.9), "every": 1, "max_modes": 3}),
    (40, 1): (9.4, ("cantilever_40cm_run1*", "cantilever_40cm_run2*"), LATE),
    (40, 2): (
        61.5,
        ("cantilever_40cm_run1*", "cantilever_40cm_run2*"),
        {"between_s": (0.5, 4.0), "every": 1, "max_modes": 3},
    ),
    (50, 1): (6.0, ("50cm*11-46-55*", "50cm*11-47-32*", "50cm*11-47-59*"), LATE),
    (50, 2): (39.0, ("50cm*11-46-55*", "50cm*11-47-32*", "50cm*11-47-59*"), LATE),
}
# Modes further from the expected frequency are others.
NEAR = 0.05


def strips(folder: Path) -> dict[float, Material]:
    """The strips of 30, 40 and 50 cm, with frequencies at small amplitude combined over the recordings."""
    found: dict[int, list[Measured]] = {}
    for (cm, number), (near_hz, patterns, options) in RECORDINGS.items():
        place = folder / ("ordinary" if cm == 40 else "al_cantilever")
        target = {} if options is LATE or number == 1 else {"target_frequency_hz": near_hz}
        each = [modes_in(place, pattern, **options, **target) for pattern in patterns]
        values = [
            m.small_amplitude_frequency
            for modes in each
            for m in modes
            if abs(m.frequency_hz / near_hz - 1) < NEAR
        ]
        one = combine(*zip(*values, strict=True))
        found.setdefault(cm, []).append(
            Measured(f"{cm} cm, mode {number}, {len(values)} recordings", one.value, one.sd)
        )
    return {10.0 * cm: strip(10.0 * cm, *modes) for cm, modes in found.items()}


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
                f"{length_mm:g}", str(number), f"{e.frequency_hz:.4f} ± {e.frequency_sd_hz:.4f}", f"{e.value:.1f}",
                f"{corrected.value:.1f} ± {corrected.sd:.1f}", f"{corrected.q05:.1f} to {corrected.q95:.1f}",
            ])  # fmt: skip
    return rows


def hidden_length(found: dict[float, Material]) -> list[list[str]]:
    """E and the length x of bar that is as compliant as the clamp, from ``E (1 - 4 x / l)`` of the strips."""
    rows = [["mode", "E without the clamp / GPa", "90 % interval / GPa", "clamp as compliant as / mm of bar"]]
    lengths = np.array(list(found))
    for number in (1, 2):
        key = (number, "E_corrected")
        e = np.array([v.value for one in found.values() for v in one.values if (v.mode, v.quantity) == key])
        inverse = np.linalg.pinv(np.column_stack([np.ones(lengths.size), -4.0 / lengths]))
        at_infinity, slope = inverse @ e
        # errors of the free lengths, one each; thickness and density are common to the strips
        own, common = LENGTH_SD_MM * 4.0 / lengths * e, np.hypot(2.0 * THICKNESS_SD, DENSITY_SD) * at_infinity
        reach = 1.645 * float(np.hypot(np.linalg.norm(inverse[0] * own), common))
        x, x_sd = slope / at_infinity, float(np.linalg.norm(inverse[1] * own)) / at_infinity
        interval = f"{at_infinity - reach:.1f} to {at_infinity + reach:.1f}"
        rows.append([str(number), f"{at_infinity:.1f}", interval, f"{x:.1f} ± {x_sd:.1f}"])
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
