"""Which flags an identified mode carries, and the sentences that go with them."""

from __future__ import annotations

import numpy as np

from modal_id import flags
from modal_id.data.outliers import beyond_limit
from modal_id.fit.decay import frequency_hz
from modal_id.fit.linear import FitData
from modal_id.fit.order import ModalFit
from modal_id.fit.spectrum import nyquist_hz
from modal_id.fit.subspace import StabilityDiagram
from modal_id.modes.numbering import possible_aliases
from modal_id.results import AmplitudeDependence, Posterior
from modal_id.settings import IdentifySettings
from tracker.arrays import ComplexArray, FloatArray

Raised = list[tuple[flags.ModeFlag, bool]]

# With more of the amplitude left at the end of the record, whether damping depends on it is told by extrapolation only.
LITTLE_LOST = 0.6
_MANY_OUTLIERS = 0.03
_NEAR_UNRESOLVED = 0.03


def of_the_fit(
    model: ModalFit,
    index: int,
    posterior: Posterior,
    dependence: AmplitudeDependence | None,
    *,
    long_enough: bool,
) -> tuple[flags.ModeFlag, ...]:
    """Flags that the fit and the posterior raise by themselves."""
    data, fit = model.data, model.fit
    all_hz = frequency_hz(fit.poles)
    frequency = float(all_hz[index])
    noise = np.sqrt(fit.linear.noise_variance)
    best = float(np.max(np.abs(fit.linear.amplitudes[index]) / noise))
    draws = posterior.damping_ratio
    near = np.abs(np.delete(all_hz, index) / frequency - 1.0)
    raised: Raised = [
        (flags.SHORT_RECORD, data.span_s * frequency < 10.0),
        (flags.LOW_SNR, best < 10.0),
        (flags.AMPLITUDE_DEPENDENT, dependence is not None and dependence.significant),
        (flags.CLOSE_MODE, bool(np.any(near < 0.1))),
        (flags.CHAIN_TOO_SHORT, not long_enough),
        (flags.FEW_CYCLES_LOST, float(np.exp(fit.poles[index].real * data.span_s)) > LITTLE_LOST),
        (flags.UNRESOLVED, any(abs(frequency / f - 1.0) < _NEAR_UNRESOLVED for f in model.unresolved_hz)),
        (flags.HARMONIC, _is_multiple(all_hz, np.max(np.abs(fit.linear.amplitudes), axis=1), index)),
        (flags.DAMPING_TOUCHES_ZERO, float(np.quantile(draws, 0.005)) < 0.05 * float(np.median(draws))),
    ]
    return tuple(flag for flag, up in raised if up)


def _is_multiple(all_hz: FloatArray, strength: FloatArray, index: int) -> bool:
    ratio = all_hz[index] / all_hz[strength > 3.0 * strength[index]]
    whole = np.maximum(np.round(ratio), 1.0)
    return bool(np.any((whole >= 2.0) & (np.abs(ratio / whole - 1.0) < 0.003)))


def of_the_record(
    model: ModalFit,
    index: int,
    shape: ComplexArray,
    number: int | None,
    settings: IdentifySettings,
    diagram: StabilityDiagram | None,
    rejected_share: float,
) -> tuple[tuple[flags.ModeFlag, ...], tuple[str, ...]]:
    """Flags that need the whole record: theory, the second opinion on the order, outliers; notes beside them."""
    frequency = float(frequency_hz(model.fit.poles)[index])
    nyquist = nyquist_hz(model.data.time_s)
    raised, notes = [], []
    mirrored = possible_aliases(frequency, shape, number, 2.0 * nyquist, settings)
    if frequency > 0.9 * nyquist or mirrored:
        raised.append(flags.ALIASED_POSSIBLE)
    if frequency > 0.9 * nyquist:
        notes.append(
            f"Sampled at {2.0 * nyquist:.4g} Hz, {2.0 * nyquist - frequency:.4g} Hz would look the same as "
            f"{frequency:.4g} Hz."
        )
    notes += [
        f"Sampled at {2.0 * nyquist:.4g} Hz, mode {other} of theory, expected at "
        f"{settings.expected_frequencies_hz[other - 1]:.4g} Hz, would appear near {frequency:.4g} Hz."
        for other in mirrored
    ]
    if diagram is not None and not diagram.confirms(frequency):
        raised.append(flags.NOT_CONFIRMED)
    if rejected_share > _MANY_OUTLIERS:
        raised.append(flags.MANY_OUTLIERS)
    return tuple(raised), tuple(notes)


def outlier_share(data: FitData, original_weights: FloatArray, residual: FloatArray) -> float:
    """Largest share, over channels, of the used samples that lie beyond the limit of rejection."""
    bad = np.count_nonzero(beyond_limit(data, original_weights, residual), axis=0)
    used = np.count_nonzero(original_weights > 0.0, axis=0)
    return float(np.max(bad / np.maximum(used, 1), initial=0.0))
