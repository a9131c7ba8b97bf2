"""Severity of the flags of a mode by their effect on its frequency and damping ratio."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modal_id.fit import ModalFit
from modal_id.flags import ModeFlag
from modal_id.modes.flag_rules import LOW_SNR, signal_to_noise
from modal_id.posterior import SampledMode, left_at_mode
from modal_id.results import AmplitudeDependence
from tracker import Severity


@dataclass(frozen=True)
class Tuning:
    """What affects an interval."""

    #: [1] part of the standard deviation over it that affects the interval
    share: float = 0.5
    #: [1] relative increase of the standard deviation that affects the interval
    noticeable: float = 0.1
    #: [1] residual power over the noise from which the values may be wrong
    far_too_much_left: float = 10.0


TUNING = Tuning()

# Changes over the record below both of these, relative to the value, have no practical consequence: 0.05 % of f, 5 % of
# zeta.
_SMALL_CHANGE = (5e-4, 0.05)
# Standard deviations, relative to the value, from which an interval is wide.
_WIDE = (0.01, 0.2)


def severities(
    model: ModalFit, index: int, mode: SampledMode, flags: list[ModeFlag]
) -> tuple[tuple[str, str], ...]:
    """Name and severity of each flag of the mode with this index."""
    draws = mode.posterior
    values = (float(np.median(draws.frequency_hz)), float(np.median(draws.damping_ratio)))
    sd = (float(np.std(draws.frequency_hz)), float(np.std(draws.damping_ratio)))
    model_sd = (draws.systematic_frequency_hz, draws.systematic_damping_ratio)
    shares = [part / max(whole, 1e-300) for part, whole in zip(model_sd, sd, strict=True)]
    wide = any(own > limit * value for own, value, limit in zip(sd, values, _WIDE, strict=True))
    weak = signal_to_noise(model, index) < LOW_SNR
    affects = {
        ModeFlag.AMPLITUDE_DEPENDENT: max(shares) > TUNING.share and not _is_small(mode.dependence),
        ModeFlag.FEW_CYCLES_LOST: draws.extrapolation_damping_ratio > TUNING.share * sd[1],
        ModeFlag.SHORT_RECORD: wide,
        ModeFlag.LOW_SNR: wide,
        ModeFlag.CLOSE_MODE: _coupling(model, index) > 1.0 + TUNING.noticeable,
        ModeFlag.CHAIN_TOO_SHORT: min(draws.ess) < TUNING.noticeable**-2.0,
    }
    found = {flag: flag.usual_severity for flag in flags}
    for flag in flags:
        if flag in affects:
            found[flag] = Severity.INTERVAL if affects[flag] else Severity.INFORMATION
    if ModeFlag.FEW_CYCLES_LOST in found and ModeFlag.DAMPING_TOUCHES_ZERO in found:
        # Both flags are due to little decay; one of them is enough at the higher severity.
        found[ModeFlag.DAMPING_TOUCHES_ZERO] = Severity.INFORMATION
    if ModeFlag.NOT_CONFIRMED in found and not weak:
        found[ModeFlag.NOT_CONFIRMED] = Severity.INFORMATION
    if ModeFlag.RESIDUAL_AT_MODE in found and left_at_mode(mode.dependence) < TUNING.far_too_much_left:
        found[ModeFlag.RESIDUAL_AT_MODE] = Severity.INTERVAL
    return tuple((flag.name, severity.name) for flag, severity in found.items())


def _is_small(dependence: AmplitudeDependence | None) -> bool:
    """Whether the changes of frequency and damping ratio over the record have no practical consequence."""
    if dependence is None:
        return True
    if dependence.curve is None:
        changes = (dependence.f2_hz / dependence.f0_hz, dependence.zeta1 / dependence.zeta0)
    else:
        curve = dependence.curve
        ranges = (np.ptp(curve.frequency_hz), np.ptp(curve.damping_ratio))
        changes = (ranges[0] / curve.frequency_hz[0], ranges[1] / curve.damping_ratio[0])
    return all(abs(float(change)) < limit for change, limit in zip(changes, _SMALL_CHANGE, strict=True))


def _coupling(model: ModalFit, index: int) -> float:
    """Standard deviation of the pole relative to that with all other poles known; the larger of both parts."""
    covariance = model.fit.covariance
    scale = 1.0 / np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    correlation = covariance * np.outer(scale, scale)
    own = slice(2 * index, 2 * index + 2)
    alone = np.linalg.inv(np.linalg.pinv(correlation, hermitian=True)[own, own])
    return float(np.sqrt(np.max(np.diag(correlation[own, own]) / np.maximum(np.diag(alone), 1e-12))))
