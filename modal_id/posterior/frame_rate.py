"""Uncertainty of the frame rate: one factor on all frequencies of a recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from modal_id.results import DrivenMotion, Identification, IdentifiedMode


def with_rate_error(found: Identification) -> Identification:
    """The identification with the error of the frame rate in every frequency; unchanged where the rate is exact.

    A wrong rate stretches time: all frequencies are wrong by the same factor, damping ratios and ratios of frequencies
    are not. The draws of all modes are therefore multiplied by the same random factors of mean 1; driven motions have
    no draws, and their standard deviations are increased.
    """
    ppm = found.series.rate_sd_ppm
    if ppm == 0.0:
        return found
    note = (
        f"The frame rate is known to {ppm:g} ppm (relative sd): the interval of every frequency includes it. The error "
        "is common to all modes and to all recordings of one camera, and does not affect damping ratios. If the rate "
        "is known better, give fps_tolerance_ppm."
    )
    return replace(
        found,
        modes=tuple(_widened(mode, ppm) for mode in found.modes),
        driven=tuple(_widened_line(line, ppm) for line in found.driven),
        notes=(*found.notes, note),
    )


def _widened_line(line: DrivenMotion, ppm: float) -> DrivenMotion:
    return replace(
        line, frequency_sd_hz=float(np.hypot(line.frequency_sd_hz, 1e-6 * ppm * line.frequency_hz))
    )


def _widened(mode: IdentifiedMode, ppm: float) -> IdentifiedMode:
    posterior, dependence = mode.posterior, mode.amplitude_dependence
    frequency_hz = posterior.frequency_hz * posterior.rate_factors(ppm)
    if dependence is not None:
        f0_sd_hz = float(np.hypot(dependence.f0_sd_hz, 1e-6 * ppm * dependence.f0_hz))
        curve = dependence.curve
        if curve is not None:
            curve = replace(
                curve, frequency_sd_hz=np.hypot(curve.frequency_sd_hz, 1e-6 * ppm * curve.frequency_hz)
            )
        dependence = replace(dependence, f0_sd_hz=f0_sd_hz, curve=curve)
    widened = replace(posterior, frequency_hz=frequency_hz, rate_sd_ppm=ppm)
    return replace(mode, posterior=widened, amplitude_dependence=dependence)
