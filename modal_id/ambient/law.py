"""What a record of a given length can determine: the uncertainty law of ambient identification."""

from __future__ import annotations

import numpy as np

# [1] relative sds of the damping ratio that the report names
_AIMS = (0.3, 0.1, 0.05)


def log_sds(frequency_hz: float, damping_ratio: float, span_s: float, reach: float) -> tuple[float, float]:
    """Relative standard deviations of frequency and damping ratio for a strong mode and a band of f (1 +- reach zeta).

    Notes
    -----
    Au (2014), Structural Safety 48, doi:10.1016/j.strusafe.2014.02.001, eq. 1-4: with N_c cycles,
    ``(sd f / f)^2 = zeta / (2 pi N_c B_f)`` and ``(sd zeta / zeta)^2 = 1 / (2 pi zeta N_c B_z)``, where
    ``B_f = (2 / pi) (atan k - k / (k^2 + 1))`` and
    ``B_z = (2 / pi) (atan k + k / (k^2 + 1) - 2 atan(k)^2 / k)`` for a reach of k half-widths. They follow from the
    information of the logarithm of the density, ``sum (d ln D / d theta)^2``, with the level of the force unknown.
    """
    angle, ratio = np.arctan(reach), reach / (reach**2 + 1.0)
    cycles = frequency_hz * span_s
    of_f = 2.0 / np.pi * (angle - ratio)
    of_zeta = 2.0 / np.pi * (angle + ratio - 2.0 * angle**2 / reach)
    f_sd = np.sqrt(damping_ratio / (2.0 * np.pi * cycles * of_f))
    return float(f_sd), float(1.0 / np.sqrt(2.0 * np.pi * damping_ratio * cycles * of_zeta))


def law_note(span_s: float, frequency_hz: float, damping_ratio: float, log_sd: float) -> str:
    """What the record gives, and how long a record would give more: the square of the sd falls with the length."""
    aim = next((aim for aim in _AIMS if aim < 0.8 * log_sd), 0.5 * log_sd)
    needed_s = span_s * (log_sd / aim) ** 2
    return (
        f"This record of {span_s / 60.0:.3g} min ({frequency_hz * span_s:.0f} cycles) gives the damping ratio, "
        f"{100.0 * damping_ratio:.3g} %, to {100.0 * log_sd:.2g} % of its value; {needed_s / 60.0:.2g} min would give "
        f"it to {100.0 * aim:.2g} %."
    )
