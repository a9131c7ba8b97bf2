"""Compute the tables of `cantilever.md` and write them: ``python docs/studies/cantilever.py FOLDER``, from the root.

FOLDER contains the recordings `30cm_adxl_*.npy` and `50cm_adxl_*.npy` cited on the page.
"""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from tracker import FloatArray

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT)]

from modal_id import (  # noqa: E402
    IdentifiedMode,
    IdentifySettings,
    identify,
)
from sim.beam import (  # noqa: E402
    AncfBeam,
    BeamProperties,
    ElasticClamp,
    Orientation,
    PointMass,
    beam_modes,
)
from tracker import DisplacementSeries  # noqa: E402

PAGE = Path(__file__).with_name("cantilever.md")
WIDTH_M, THICKNESS_M, DENSITY_KG_M3, POISSON = 50.8e-3, 2.03e-3, 2700.0, 0.33
HANDBOOK_PA, SENSOR_KG, SENSOR_SIDE_M, FROM_TIP_M = 70e9, 5e-3, 20e-3, 60e-3
INERTIA_M4 = WIDTH_M * THICKNESS_M**3 / 12.0
LENGTHS_M = (0.3, 0.5)
ORIENTATIONS: tuple[Orientation, ...] = ("none", "hanging", "standing")
# from the authors' spectra (points_data.xlsx): free length, modes 1 and 2; not used in the fit, resolution 0.05 Hz
AUTHORS_HZ = {0.4: (9.383, 61.537), 0.6: (4.25, 27.347)}
# roots beta L of the clamped-free beam
BETA_L = (1.8751041, 4.6940911)
# mode 2 is within 2e-5 of theory
_ELEMENTS = 12
# clipping level of the recordings in g
_CLIP_G = 9.79
# every fourth sample: 1 kHz for modes below 110 Hz
_EVERY = 4


@dataclass(frozen=True)
class Strip:
    """Parameters relative to the handbook values, and the rotational stiffness of the clamp (None: rigid)."""

    modulus: float = 1.0
    clamp_n_m: float | None = None
    sensor: float = 1.0
    lengthening_m: tuple[float, float] = (0.0, 0.0)
    moved_m: float = 0.0
    orientation: Orientation = "none"


# prior standard deviations: E including the thickness of the strip, clamp (nearly flat), sensor with cable, free
# lengths measured with a ruler, position of the sensor
PRIOR_SD = np.array([0.1, 3.0, 0.2, 1e-3, 1e-3, 3e-3])


def frequencies_hz(strip: Strip, length_m: float) -> FloatArray:
    """Natural frequencies of modes 1 and 2."""
    longer = strip.lengthening_m[LENGTHS_M.index(length_m)] if length_m in LENGTHS_M else 0.0
    mass = SENSOR_KG * strip.sensor
    bodies = (
        PointMass(length_m + longer - FROM_TIP_M - strip.moved_m, mass, mass * SENSOR_SIDE_M**2 / 12.0),
    )
    properties = BeamProperties.uniform(
        length_m=length_m + longer,
        width_m=WIDTH_M,
        thickness_m=THICKNESS_M,
        density_kg_m3=DENSITY_KG_M3,
        elastic_modulus_pa=HANDBOOK_PA * strip.modulus,
        orientation=strip.orientation,
        elements=_ELEMENTS,
        clamp=None if strip.clamp_n_m is None else ElasticClamp(strip.clamp_n_m),
        point_masses=bodies if mass > 0.0 else (),
    )
    return np.asarray(beam_modes(AncfBeam(properties), 2).frequency_hz)


def all_four_hz(strip: Strip) -> FloatArray:
    return np.concatenate([frequencies_hz(strip, length) for length in LENGTHS_M])


def plate_effect() -> FloatArray:
    """Upper limit of the relative increase of the four frequencies of a wide strip over those of a beam.

    A strip with curvature w'' has the anticlastic curvature nu w'' across its width. Where w'' varies along the strip,
    this twists it. The energy of the twist, relative to the bending energy, is
    nu^2 b^2 / (6 (1 + nu)) int w'''^2 / int w''^2 if the anticlastic curvature is unrestrained.
    """
    x = np.linspace(0.0, 1.0, 4001)
    out = []
    for length in LENGTHS_M:
        for beta in BETA_L:
            sigma = (np.cosh(beta) + np.cos(beta)) / (np.sinh(beta) + np.sin(beta))
            second = np.cosh(beta * x) + np.cos(beta * x) - sigma * (np.sinh(beta * x) + np.sin(beta * x))
            third = np.sinh(beta * x) - np.sin(beta * x) - sigma * (np.cosh(beta * x) + np.cos(beta * x))
            ratio = (beta / length) ** 2 * np.mean(third**2) / np.mean(second**2)
            out.append(0.5 * POISSON**2 * WIDTH_M**2 / (6.0 * (1.0 + POISSON)) * ratio)
    return np.array(out)


@dataclass(frozen=True)
class Measured:
    """Natural frequency of one length and mode: mean and standard deviation over repeats."""

    name: str
    frequency_hz: float
    sd_hz: float


def measured(folder: Path) -> list[Measured]:
    """Identify the four frequencies at small amplitude from the recordings.

    The sensor of the shorter strip is close to the node of mode 2; only the first second of two recordings contains
    that mode, beside a weaker one at 310 Hz.
    """
    short = [
        modes_in(folder, pattern, max_modes=1)
        for pattern in ("30cm*21-08-55*", "30cm*21-12-02*", "30cm*21-13-02*")
    ]
    first = [
        modes_in(folder, pattern, between_s=between, every=1, max_modes=3, target_frequency_hz=108.0)
        for pattern, between in (("30cm*21-12-02*", (0.17, 1.2)), ("30cm*21-13-02*", (0.1, 0.9)))
    ]
    long = [
        modes_in(folder, pattern, max_modes=2)
        for pattern in ("50cm*11-46-55*", "50cm*11-47-32*", "50cm*11-47-59*")
    ]
    return [
        _mean("30 cm, mode 1", [_near(m, 16.0) for m in short]),
        _mean("30 cm, mode 2", [_near(m, 108.0) for m in first]),
        _mean("50 cm, mode 1", [_near(m, 6.0) for m in long]),
        _mean("50 cm, mode 2", [_near(m, 39.0) for m in long]),
    ]


def modes_in(
    folder: Path,
    pattern: str,
    *,
    between_s: tuple[float, float] | None = None,
    every: int = _EVERY,
    max_modes: int,
    target_frequency_hz: float | None = None,
) -> tuple[IdentifiedMode, ...]:
    (path,) = folder.glob(pattern)
    time_s, acceleration_g = np.load(path)
    onset_s = end_s = None
    if between_s is not None:
        # one free decay; clipped samples are missing
        inside = (time_s >= between_s[0]) & (time_s < between_s[1])
        time_s, acceleration_g = time_s[inside], acceleration_g[inside]
        acceleration_g = np.where(np.abs(acceleration_g) > _CLIP_G, np.nan, acceleration_g)
        onset_s, end_s = float(time_s[0]), float(time_s[-1])
    values = acceleration_g[::every, None]
    series = DisplacementSeries(
        name=path.name,
        time_s=time_s[::every],
        channels=("sensor",),
        values=values,
        sd=np.full(values.shape, np.nan),
        unit="g",
        positions_mm=np.array([np.nan]),
    )
    found = identify(
        series,
        IdentifySettings(
            max_modes=max_modes, target_frequency_hz=target_frequency_hz, onset_s=onset_s, end_s=end_s
        ),
    )
    return found.modes if found else ()


def _near(modes: tuple[IdentifiedMode, ...], frequency_hz: float) -> float:
    mode = min(modes, key=lambda m: abs(m.frequency_hz - frequency_hz))
    return mode.small_amplitude_frequency[0]


def _mean(name: str, values: list[float]) -> Measured:
    return Measured(name, float(np.mean(values)), float(np.std(values, ddof=1)))


@dataclass(frozen=True)
class Fit:
    """Fitted properties, the covariance of (ln E, ln k, ln mass, two lengths, position), and chi-square."""

    strip: Strip
    covariance: FloatArray
    chi_square: float


def fit(
    found: list[Measured], *, sensor: bool, nuisances: bool = False, orientation: Orientation = "none"
) -> Fit:
    """Fit E and the clamp stiffness by least squares, and optionally the other parameters with their priors.

    The variance of each frequency combines the scatter of its repeats, the error of beam theory (`plate_effect`) and,
    if the free lengths are not fitted, their uncertainty of 1 mm.
    """
    free = np.array([0, 1, *([2] if sensor else []), *([3, 4, 5] if nuisances else [])])
    goal = np.log([m.frequency_hz for m in found])
    sd = np.hypot([m.sd_hz / m.frequency_hz for m in found], plate_effect())
    if not nuisances:
        sd = np.hypot(sd, 2.0 * PRIOR_SD[3] / np.repeat(LENGTHS_M, 2))
    scale = np.where(np.arange(6) == 1, 0.3, PRIOR_SD)

    def strip(x: FloatArray) -> Strip:
        full = np.zeros(6)
        full[free] = x * scale[free]
        return Strip(
            float(np.exp(full[0])), float(300.0 * np.exp(full[1])), float(np.exp(full[2])),
            (float(full[3]), float(full[4])), float(full[5]), orientation,
        )  # fmt: skip

    def residuals(x: FloatArray) -> FloatArray:
        misfit = (np.log(all_four_hz(strip(x))) - goal) / sd
        return np.concatenate([misfit, x * scale[free] / PRIOR_SD[free]])

    def slopes(x: FloatArray) -> FloatArray:
        # steps well above the rounding error of the eigenvalues, 1e-7
        steps = 0.05 * np.eye(x.size)
        return np.column_stack([(residuals(x + h) - residuals(x - h)) / 0.1 for h in steps])

    best = least_squares(residuals, np.zeros(free.size), jac=slopes, xtol=1e-6, ftol=1e-9, gtol=1e-6)
    covariance = np.zeros((6, 6))
    covariance[np.ix_(free, free)] = np.linalg.inv(best.jac.T @ best.jac) * np.outer(scale[free], scale[free])
    return Fit(strip(best.x), covariance, float(2.0 * best.cost))


def model_variants(found: list[Measured]) -> dict[str, Strip]:
    """Models of the strip, from handbook values to the full fit."""
    return {
        "rigid clamp, no sensor": Strip(sensor=0.0),
        "rigid clamp, 5 g": Strip(),
        "E and clamp": fit(found, sensor=False).strip,
        "E and clamp, hanging": fit(found, sensor=False, orientation="hanging").strip,
        "E, clamp and sensor": fit(found, sensor=True).strip,
    }


def errors_table(found: list[Measured]) -> list[list[str]]:
    """Table rows: each measured frequency and the deviation of each model in %."""
    models = model_variants(found)
    rows = [["frequency", "measured / Hz", "scatter / Hz", *(f"{name} / %" for name in models)]]
    columns = [
        100.0 * (all_four_hz(strip) / [m.frequency_hz for m in found] - 1.0) for strip in models.values()
    ]
    rows += [
        [m.name, f"{m.frequency_hz:.4f}", f"{m.sd_hz:.4f}", *(f"{c[k]:+.2f}" for c in columns)]
        for k, m in enumerate(found)
    ]
    for length, authors_hz in AUTHORS_HZ.items():
        ratios = [frequencies_hz(strip, length) / authors_hz for strip in models.values()]
        rows += [
            [
                f"{100 * length:g} cm, mode {mode + 1} (authors)",
                f"{authors_hz[mode]:g}",
                "",
                *(f"{100.0 * (r[mode] - 1.0):+.2f}" for r in ratios),
            ]
            for mode in range(2)
        ]
    return rows


def posterior_table(found: list[Measured]) -> list[list[str]]:
    """Table rows: posterior of each property for each orientation of the strip."""
    names = {"none": "sideways", "hanging": "hanging", "standing": "standing"}
    rows = [
        [
            "strip",
            "E / GPa",
            "clamp / (N m/rad)",
            "EI / clamp / mm",
            "E with clamp",
            "sensor / g",
            "30 cm / mm",
            "50 cm / mm",
            "chi2",
        ]
    ]
    for orientation in ORIENTATIONS:
        one = fit(found, sensor=True, nuisances=True, orientation=orientation)
        sd, strip = np.sqrt(np.diag(one.covariance)), one.strip
        clamp = strip.clamp_n_m or float("nan")
        flexibility_mm = 1e3 * HANDBOOK_PA * strip.modulus * INERTIA_M4 / clamp
        gradient = np.array([1.0, -1.0, 0.0, 0.0, 0.0, 0.0])
        mass = 1e3 * SENSOR_KG * strip.sensor
        lengths = [1e3 * (a + b) for a, b in zip(LENGTHS_M, strip.lengthening_m, strict=True)]
        rows.append(
            [
                names[orientation],
                f"{1e-9 * HANDBOOK_PA * strip.modulus:.2f} ± {1e-9 * HANDBOOK_PA * strip.modulus * sd[0]:.2f}",
                f"{clamp:.0f} ± {clamp * sd[1]:.0f}",
                f"{flexibility_mm:.2f} ± {flexibility_mm * float(np.sqrt(gradient @ one.covariance @ gradient)):.2f}",
                f"{one.covariance[0, 1] / (sd[0] * sd[1]):.2f}",
                f"{mass:.2f} ± {mass * sd[2]:.2f}",
                *(f"{value:.2f} ± {1e3 * s:.2f}" for value, s in zip(lengths, sd[3:5], strict=True)),
                f"{one.chi_square:.2f}",
            ]
        )
    return rows


def as_markdown(rows: list[list[str]]) -> str:
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join([lines[0], "|" + " --- |" * len(rows[0]), *lines[1:]])


def rows_of(text: str, name: str) -> list[list[str]]:
    """Cells of the table with this name on the page, header first."""
    body = text.split(f"<!-- {name} -->\n")[1].split(f"<!-- end of {name} -->", maxsplit=1)[0]
    lines = body.strip().splitlines()
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in (lines[0], *lines[2:])]


def measured_on(text: str) -> list[Measured]:
    """Measured frequencies as printed on the page."""
    rows = [row for row in rows_of(text, "errors")[1:] if re.fullmatch(r"[35]0 cm, mode [12]", row[0])]
    return [Measured(row[0], float(row[1]), float(row[2])) for row in rows]


def main() -> None:
    """Identify the frequencies, compute the tables and write them into the page."""
    found = measured(Path(sys.argv[1]))
    text = PAGE.read_text(encoding="utf-8")
    for name, rows in (("errors", errors_table(found)), ("posterior", posterior_table(found))):
        head, rest = text.split(f"<!-- {name} -->\n", 1)
        tail = rest.split(f"<!-- end of {name} -->", 1)[1]
        text = f"{head}<!-- {name} -->\n{as_markdown(rows)}\n<!-- end of {name} -->{tail}"
    PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
