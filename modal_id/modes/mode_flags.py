"""Which flags an identified mode receives, and the notes that explain them."""

from __future__ import annotations

import numpy as np

from modal_id import flags
from modal_id.data.outliers import beyond_limit
from modal_id.fit.model_order import ModalFit
from modal_id.fit.poles import frequency_hz
from modal_id.fit.spectrum import nyquist_hz
from modal_id.fit.subspace import StabilityDiagram
from modal_id.modes.numbering import possible_aliases
from modal_id.posterior.mode_posterior import LITTLE_DECAY, SampledMode
from modal_id.settings import IdentifySettings
from tracker.arrays import ComplexArray, FloatArray

MANY_OUTLIERS = 0.03
_NEAR_UNRESOLVED = 0.03


def fit_flags(model: ModalFit, index: int, mode: SampledMode) -> tuple[flags.ModeFlag, ...]:
    """Flags that depend on the fit and the posterior of the mode."""
    data, fit = model.data, model.fit
    all_hz = frequency_hz(fit.poles)
    frequency = float(all_hz[index])
    noise = np.sqrt(fit.linear.noise_variance)
    best = float(np.max(np.abs(fit.linear.amplitudes[index]) / noise))
    draws = mode.posterior.damping_ratio
    distance = np.abs(np.delete(all_hz, index) / frequency - 1.0)
    raised = [
        (flags.SHORT_RECORD, data.span_s * frequency < 10.0),
        (flags.LOW_SNR, best < 10.0),
        (flags.AMPLITUDE_DEPENDENT, mode.dependence is not None and mode.dependence.significant),
        (flags.CLOSE_MODE, bool(np.any(distance < 0.1))),
        (flags.CHAIN_TOO_SHORT, not mode.long_enough),
        (flags.FEW_CYCLES_LOST, float(np.exp(fit.poles[index].real * data.span_s)) > LITTLE_DECAY),
        (flags.UNRESOLVED, any(abs(frequency / f - 1.0) < _NEAR_UNRESOLVED for f in model.unresolved_hz)),
        (flags.HARMONIC, _is_multiple(all_hz, np.max(np.abs(fit.linear.amplitudes), axis=1), index)),
        (flags.DAMPING_TOUCHES_ZERO, float(np.quantile(draws, 0.005)) < 0.05 * float(np.median(draws))),
    ]
    return tuple(flag for flag, is_raised in raised if is_raised)


def _is_multiple(all_hz: FloatArray, strength: FloatArray, index: int) -> bool:
    ratio = all_hz[index] / all_hz[strength > 3.0 * strength[index]]
    whole = np.maximum(np.round(ratio), 1.0)
    return bool(np.any((whole >= 2.0) & (np.abs(ratio / whole - 1.0) < 0.003)))


def record_flags(
    model: ModalFit,
    index: int,
    shape: ComplexArray,
    number: int | None,
    settings: IdentifySettings,
    diagram: StabilityDiagram | None,
    outliers: float,
) -> tuple[tuple[flags.ModeFlag, ...], tuple[str, ...]]:
    """Flags that depend on theory, the stability diagram and the share of outliers in the record, with their notes."""
    frequency = float(frequency_hz(model.fit.poles)[index])
    nyquist = nyquist_hz(model.data.time_s)
    raised, notes = [], []
    aliases = possible_aliases(frequency, shape, number, 2.0 * nyquist, settings)
    if frequency > 0.9 * nyquist or aliases:
        raised.append(flags.ALIASED_POSSIBLE)
    if frequency > 0.9 * nyquist:
        notes.append(
            f"At a sampling rate of {2.0 * nyquist:.4g} Hz, a vibration at {2.0 * nyquist - frequency:.4g} Hz cannot "
            f"be distinguished from one at {frequency:.4g} Hz."
        )
    notes += [
        f"At a sampling rate of {2.0 * nyquist:.4g} Hz, mode {other}, which theory predicts at "
        f"{settings.expected_frequencies_hz[other - 1]:.4g} Hz, would appear near {frequency:.4g} Hz."
        for other in aliases
    ]
    if diagram is not None and not diagram.confirms(frequency):
        raised.append(flags.NOT_CONFIRMED)
    if outliers > MANY_OUTLIERS:
        raised.append(flags.MANY_OUTLIERS)
    return tuple(raised), tuple(notes)


def outlier_share(weights: FloatArray, residual: FloatArray) -> float:
    """Largest share, over channels, of the used samples beyond the limit of rejection."""
    bad = np.count_nonzero(beyond_limit(weights, residual), axis=0)
    used = np.count_nonzero(weights > 0.0, axis=0)
    return float(np.max(bad / np.maximum(used, 1), initial=0.0))
