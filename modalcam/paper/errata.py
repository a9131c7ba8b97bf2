"""What in the paper does not agree with itself: each with the numbers that show it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modalcam.paper.recomputed import HANDBOOK_DENSITY_KG_M3, Recomputed
from modalcam.paper.words import hertz, largest, signed_percent, signed_range, within
from modalcam.report.style.format import percent, significant
from sim.reference import paper_tables as printed


@dataclass(frozen=True)
class Erratum:
    """Where it stands, what is printed, and what the numbers say."""

    place: str
    printed: str
    computed: str


def errata(paper: Recomputed) -> tuple[Erratum, ...]:
    """The list in the paper's order."""
    standard, optimum, e = paper.standard, paper.optimum, paper.equations
    column, test = np.array(printed.TABLE_3_STANDARD_HZ), np.array(printed.TABLE_3_TEST_HZ)
    best = np.array(printed.TABLE_3_OPTIMUM_HZ)
    density = printed.TABLE_1_STANDARD.density_kg_m3
    return (
        Erratum(
            "Table 1 and 3, standard",
            f"Density {density:.0f} kg/m³",
            f"It gives frequencies {signed_range(standard.printed_density_hz / column - 1.0)} from the "
            f"printed ones; {HANDBOOK_DENSITY_KG_M3:.0f} kg/m³ gives them within "
            f"{within(largest(standard.handbook_density_hz / column - 1.0))}. A modulus changed by "
            f"{signed_percent(density / HANDBOOK_DENSITY_KG_M3 - 1.0)} would do the same.",
        ),
        Erratum(
            "Table 3, standard",
            "A vertical beam, frequencies without gravity",
            f"Gravity moves the hanging beam’s mode 1 from {hertz(standard.printed_density_hz[0])} to "
            f"{hertz(standard.hanging_hz[0])} Hz; the test has {hertz(test[0])} Hz. The 42 variables are "
            "asked to make up for it.",
        ),
        Erratum(
            "Table 1 and 3, optimum",
            "One row of properties for the optimum",
            f"As uniform values they give frequencies {signed_range(optimum.uniform_hz / best - 1.0)} from "
            "the printed optimum.",
        ),
        Erratum(
            "Table 3, optimum",
            "The optimum of 42 variables",
            f"It misses the test by {signed_range(best / test - 1.0)}; the same variables within the same "
            f"{percent(printed.VARIABLE_BOUND)} reach it within "
            f"{within(largest(optimum.to_test.paper.updated_hz / test - 1.0))}, in infinitely many ways.",
        ),
        Erratum(
            "Eq. 6",
            "C_g = Φᵀ C_r Φᵀ = M Φ [2 ζ ω] Φᵀ M",
            "The two sides are not the same: put into Eq. 5 for the standard beam, the right side gives C_r "
            f"back within {significant(e.eq6_right_error, 1)} of its size, the left side misses it by "
            f"{significant(e.eq6_printed_error, 1)} times its size in SI units. Meant is Φ⁻ᵀ C_r Φ⁻¹.",
        ),
        Erratum(
            "Eq. 6",
            "The generic damping matrix, of five measured modes",
            f"It gives mode {len(test) + 1} a damping ratio of {_tiny(e.ratio_above)}: every mode above the "
            "last measured one rings for ever, which the paper does not say. The generic model here gives "
            "those a stated residual.",
        ),
        Erratum("Eq. 1 and 2", "ξ beside ζ; minimum over ω_r and ζ_r", _EQ_2),
    )


_EQ_2 = (
    "ξ is ζ. The initial displacement and velocity of Eq. 1 are unknown too; they are linear, and found with "
    "the two that Eq. 2 names."
)


def _tiny(value: float) -> str:
    return "0" if abs(value) < 1e-12 else significant(value, 2)
