"""Modes of a record under ambient excitation: bands of its spectrum, the modes in each, and what they leave open."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from modal_id.ambient.bands import TUNING as BANDS
from modal_id.ambient.bands import Band, Peak, Tail, band_data, bands_of, find_peaks_of, singular_values
from modal_id.ambient.model import WIDEST, BandFit, spectrum
from modal_id.ambient.order import WIDTHS, choose_order, misfit, shares
from modal_id.ambient.spectrum import Spectrum, not_stationary, spectrum_of, variance
from modal_id.data import Prepared
from modal_id.fit import SAME_LINE, nyquist_hz, stability_diagram
from modal_id.modes import CLEAR_SD, CLOSE, numbered
from modal_id.posterior import with_rate_error
from modal_id.record import Onset, Segment
from modal_id.response import DRAWS, MOST_FREQUENCIES
from modal_id.results import AmbientBand, AmbientRecord, FailedMode, Identification, IdentifiedMode, Posterior
from modal_id.sentences import ModeFlag, Note, Reason, Refusal
from modal_id.settings import IdentifySettings
from tracker import BoolArray, DisplacementSeries, Failure, FloatArray

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
    zeta, percent, aim = 100.0 * damping_ratio, 100.0 * log_sd, 100.0 * aim
    span_min, needed_min, cycles = span_s / 60.0, needed_s / 60.0, frequency_hz * span_s
    return Note.DAMPING_KNOWN(
        span_min=span_min, cycles=cycles, zeta=zeta, percent=percent, needed_min=needed_min, aim=aim
    )


@dataclass(frozen=True)
class Tuning:
    """Which modes are listed, and how often bands are fitted."""

    #: [1] share of a mode in the power at its frequency in its own direction
    #: physics: Below one half, the rest of the motion hides its peak: it is what the skirts of a stronger mode leave.
    least_share: float = 0.5
    #: [1] half-width over the largest that a band allows, from which a response is part of the background
    widest: float = 0.9
    #: [modes] number of modes of other bands whose tails are part of the model of a band
    #: physics: One on each side; those beyond are weaker and change less.
    tails: int = 2
    #: [rounds] number of times that bands are chosen by the damping ratios fitted before
    #: measurement: With one less, the weaker of two modes 3 % apart was seen in the last wide one, and lost.
    rounds: int = 4
    #: [rounds] number of the last rounds, whose bands are narrow and have tails
    #: physics: What is no mode beside the tails of others may have had a tail itself.
    narrow: int = 2
    #: [1] change of the limits of a band over its width, below which it is not fitted again
    same_band: float = 0.1
    #: [1] sd of ln zeta from which a mode is not determined
    #: statistics: The 90 % interval then covers a factor of 5 either way.
    most_log_sd: float = 1.0
    #: [turns] zeta 2 pi f T below which a peak is a line: a motion of constant amplitude
    #: physics: The amplitude of a mode then has one or two independent values in the record.
    least_turns: float = 2.0


TUNING = Tuning()


@dataclass(frozen=True)
class _Found:
    """One mode of a band: f in Hz, zeta, their covariance as logarithms, shape and its sd (k,), the band."""

    frequency_hz: float
    damping_ratio: float
    covariance: FloatArray
    shape: FloatArray
    shape_sd: FloatArray
    band: Band
    misfit: float


def identify_ambient(
    series: DisplacementSeries, prepared: Prepared, settings: IdentifySettings
) -> Identification | Failure:
    """Modes of a record of stationary motion under forces that are not measured.

    Parameters
    ----------
    series : DisplacementSeries
    prepared : Prepared
        Usable samples, or components of them. Missing samples are filled up to a limit; times are even.
    settings : IdentifySettings

    Returns
    -------
    Identification or Failure
        The latter for uneven times, long gaps, a record of too few cycles, motion that is not stationary, and where no
        band holds a mode.

    Notes
    -----
    Bayesian identification from the FFT: Au (2017), Operational Modal Analysis, doi:10.1007/978-981-10-4118-1. The
    force of each mode has a flat spectrum in its band. Draws have the covariance of the
    Fisher information in ln f and ln zeta, that of ln f at the damping ratio of the draw. The values of an
    accelerometer, whose spectrum is that of the displacement times f^4, give a frequency that is too high by about
    2 zeta^2.
    """
    found = spectrum_of(prepared.data)
    if isinstance(found, Refusal):
        return found.at(series.name)
    found, fitted, lines_hz = _bands(found)
    failed = [FailedMode.of(Reason.LINE(hz=hz), hz) for hz in lines_hz]
    modes = [
        _mode(found, one.band, one.fit, index)
        for one in fitted
        for index in np.flatnonzero(one.stands_out & one.fits_in).tolist()
    ]
    modes.sort(key=lambda one: one.frequency_hz)
    listed, others = _sorted_out(found, modes)
    failed += others
    if not listed:
        why = Refusal.joined(failed or (_nothing(found, len(fitted)),))
        return replace(why, where=series.name, next_step=Note.RECORD_LONGER())
    listed = [_in_channels(one, prepared, len(series.channels)) for one in listed]
    strongest = max(listed, key=lambda one: float(np.nanmax(np.abs(one.shape))))
    problem = not_stationary(found, strongest.frequency_hz, strongest.damping_ratio)
    if problem is not None:
        return problem.at(series.name)
    result = _assembled(series, prepared, settings, found, listed, failed)
    record = AmbientRecord(*_curve(found), _spectral_bands(fitted, listed))
    return with_rate_error(replace(result, ambient=record))


@dataclass(frozen=True)
class _Fitted:
    """A band with its modes: which of them stand out, and whether the band is wide enough for each, shape (m,)."""

    band: Band
    fit: BandFit
    tails: tuple[Tail, ...]

    @property
    def stands_out(self) -> BoolArray:
        return shares(self.fit) > TUNING.least_share

    @property
    def fits_in(self) -> BoolArray:
        widest = TUNING.widest * WIDEST * (self.band.high_hz - self.band.low_hz)
        return np.array([peak.half_width_hz < widest for peak in self.peaks], dtype=bool)

    @property
    def peaks(self) -> list[Peak]:
        model = self.fit.model
        hz, half_hz = np.exp(model.log_hz).tolist(), np.exp(model.log_hz + model.log_zeta).tolist()
        return [Peak(f, half, 0.0) for f, half in zip(hz, half_hz, strict=True)]

    def tail(self, index: int) -> Tail:
        """The mode with this index, for the bands beside."""
        fit, peak = self.fit, self.peaks[index]
        shape = fit.data.directions @ fit.model.shapes[:, index]
        return Tail(peak.frequency_hz, peak.half_width_hz / peak.frequency_hz, shape)

    def is_of(self, band: Band, tails: tuple[Tail, ...]) -> bool:
        """Whether a band and the tails in it are nearly these."""
        width = band.high_hz - band.low_hz
        moved = abs(band.low_hz - self.band.low_hz) + abs(band.high_hz - self.band.high_hz)
        if len(tails) != len(self.tails) or moved > TUNING.same_band * width:
            return False
        changes = [a.frequency_hz / b.frequency_hz - 1.0 for a, b in zip(tails, self.tails, strict=True)]
        same = all(abs(change) < SAME_LINE for change in changes)
        return same and len(band.peaks) == int(np.sum(self.stands_out))


def _bands(found: Spectrum) -> tuple[Spectrum, list[_Fitted], list[float]]:
    """The fitted bands, the spectrum without lines, and the frequencies of lines.

    The first bands are those of the peaks; damping ratios that were fitted give the next ones. The first are wide: a
    mode beside a stronger one may have no peak. The last are fitted again where a tail was that of no mode.
    """
    fitted = [_fitted(found, band) for band in bands_of(found, find_peaks_of(found), BANDS.first_reach)]
    lines_hz = []
    for further in reversed(range(TUNING.rounds)):
        wide = further >= TUNING.narrow
        seen, tails = [], []
        for one in fitted:
            # A response as wide as its band allows is the mode itself in too narrow a band, or the background: a
            # second one is tried once in a wider band.
            kept = one.stands_out & (one.fits_in | (one.fit.model.count == 1) | wide)
            for index in np.flatnonzero(kept).tolist():
                peak = one.peaks[index]
                if 2.0 * np.pi * peak.half_width_hz * found.span_s < TUNING.least_turns:
                    lines_hz.append(peak.frequency_hz)
                else:
                    seen.append(peak)
                    tails.append(one.tail(index))
        found = found.without(lines_hz)
        bands = bands_of(found, seen, BANDS.first_reach if wide else 1.0)
        asked = [(band, () if wide else _beside(band, tails)) for band in bands]
        fitted = [
            next((one for one in fitted if one.is_of(*both)), None) or _fitted(found, *both) for both in asked
        ]
    return found, fitted, lines_hz


def _beside(band: Band, modes: list[Tail]) -> tuple[Tail, ...]:
    """The modes beside a band that are the strongest in it."""
    middle_hz = np.sqrt(band.low_hz * band.high_hz)
    inside = {peak.frequency_hz for peak in band.peaks}
    beside = [
        (float(np.sum(one.shape**2)) / (1.0 - (middle_hz / one.frequency_hz) ** 2) ** 2, index)
        for index, one in enumerate(modes)
        if one.frequency_hz not in inside
    ]
    return tuple(modes[index] for _, index in sorted(beside)[-TUNING.tails :])


def _fitted(found: Spectrum, band: Band, tails: tuple[Tail, ...] = ()) -> _Fitted:
    known = [(peak.frequency_hz, peak.half_width_hz) for peak in band.peaks]
    data = band_data(found, band, known, tails)
    log_places = max(float(np.log(found.frequency_hz[-1] / (band.high_hz - band.low_hz))), 0.0)
    fit = choose_order(data, (band.low_hz, band.high_hz), known, log_places)
    if fit.model.count == 0 and len(known) == 1 and band.peaks[0].strength > 0.0:
        wider = band.peaks[0]._replace(half_width_hz=WIDTHS * band.peaks[0].half_width_hz, strength=0.0)
        return _fitted(found, bands_of(found, [wider])[0], tails)
    return _Fitted(band, fit, tails)


def _mode(found: Spectrum, band: Band, fit: BandFit, index: int) -> _Found:
    model, covariance, directions = fit.model, fit.covariance, fit.data.directions
    m, r = model.count, model.exponents.size
    own = [index, m + index]
    of_shape = model.ends[4] + m * np.arange(r) + index
    vector = model.shapes[:, index]
    # Across the shape: its size is the spectral density of the force, and no property of the shape.
    shape = directions @ vector
    unit = shape / np.linalg.norm(shape)
    spread = directions @ covariance[np.ix_(of_shape, of_shape)] @ directions.T
    spread -= np.outer(unit, unit @ spread)
    spread -= np.outer(spread @ unit, unit)
    within = np.maximum(np.diag(spread), 0.0)
    # Directions that are left out hold noise, as the weakest of the others does.
    basis = np.linalg.qr(directions)[0]
    least = float(np.min(np.maximum(np.linalg.eigvalsh(basis.T @ spread @ basis)[min(1, r - 1)], 0.0)))
    beyond = np.maximum(1.0 - np.sum(basis**2, axis=1), 0.0) * least
    own_covariance = covariance[np.ix_(own, own)]
    # The likelihood is normal in the logarithms; a prior that is flat in f and zeta, as for decays, moves its centre.
    hz, zeta = np.exp(model.vector[own] + own_covariance.sum(axis=1)).tolist()
    # As the amplitude of a sinusoid of the same power.
    size = np.sqrt(2.0 * variance(hz, zeta)) * found.noise_sd
    return _Found(
        hz,
        zeta,
        own_covariance,
        size * shape,
        size * np.sqrt(within + beyond),
        band,
        misfit(fit),
    )


def _in_channels(one: _Found, prepared: Prepared, channels: int) -> _Found:
    """The mode with shape and sd in the channels of the series, NaN in those not used."""
    shape, sd = one.shape, one.shape_sd
    if prepared.projection is not None:
        back = prepared.projection.to_channels
        shape, sd = back @ shape, np.sqrt((back**2) @ sd**2)
    shape, sd = prepared.in_series(shape, channels), prepared.in_series(sd, channels)
    return replace(one, shape=shape, shape_sd=sd)


def _sorted_out(found: Spectrum, modes: list[_Found]) -> tuple[list[_Found], list[FailedMode]]:
    """Modes that the record determines, and the others with the reason."""
    good, failed = [], []
    for one in modes:
        turns = 2.0 * np.pi * one.damping_ratio * one.frequency_hz * found.span_s
        sd = float(np.sqrt(one.covariance[1, 1]))
        hz = one.frequency_hz
        if turns < TUNING.least_turns:
            why = Reason.LINE(hz=hz)
        elif sd > TUNING.most_log_sd:
            span_min, minutes = found.span_s / 60.0, found.span_s * (sd / 0.3) ** 2 / 60.0
            why = Reason.SHORT_FOR_DAMPING(span_min=span_min, hz=hz, needed_min=minutes)
        elif not one.band.low_hz * 1.0001 < hz < one.band.high_hz * 0.9999:
            continue
        else:
            good.append(one)
            continue
        failed.append(FailedMode.of(why, hz))
    return good, failed


def _nothing(found: Spectrum, bands: int) -> Refusal:
    if found.frequency_hz.size < BANDS.least_reach:
        return Reason.SHORT_FOR_SPECTRUM(span_s=found.span_s)
    return Reason.NO_BAND(count=bands, span_min=found.span_s / 60.0)


def _assembled(
    series: DisplacementSeries,
    prepared: Prepared,
    settings: IdentifySettings,
    found: Spectrum,
    listed: list[_Found],
    failed: list[FailedMode],
) -> Identification:
    frequencies = np.array([one.frequency_hz for one in listed])
    diagram = stability_diagram(
        prepared.data, np.zeros(prepared.data.values.shape), float(np.max(frequencies))
    )
    modes = []
    for index, one in enumerate(listed):
        flags = []
        if np.sum(np.abs(np.log(frequencies / one.frequency_hz)) < CLOSE) > 1:
            flags.append(ModeFlag.CLOSE_MODE)
        if one.misfit > CLEAR_SD:
            flags.append(ModeFlag.UNRESOLVED)
        if diagram is not None and not diagram.confirms(one.frequency_hz):
            flags.append(ModeFlag.NOT_CONFIRMED)
        note = law_note(
            found.span_s, one.frequency_hz, one.damping_ratio, float(np.sqrt(one.covariance[1, 1]))
        )
        mode = IdentifiedMode(
            shape=one.shape.astype(complex),
            shape_sd=one.shape_sd,
            amplitude=float(np.nanmax(np.abs(one.shape))),
            amplitude_unit=series.unit,
            posterior=_posterior(one, index, settings),
        )
        modes.append(mode.with_flags(flags, note))
    kept, others = numbered(modes, settings, 2.0 * nyquist_hz(prepared.data.time_s))
    return _of_record(series, prepared, found, kept, (*failed, *others))


def _posterior(one: _Found, index: int, settings: IdentifySettings) -> Posterior:
    """Independent draws: ln zeta is normal, and so is ln f for each zeta, with an sd that grows with its root."""
    ensembles = settings.sampler.ensembles
    sequence = np.random.SeedSequence(settings.seed, spawn_key=(*settings.seed_key, index))
    normal = np.random.default_rng(sequence).standard_normal((ensembles, DRAWS, 2))
    logs = normal @ np.linalg.cholesky(one.covariance).T
    logs[..., 0] *= np.exp(0.5 * logs[..., 1])
    sd = np.sqrt(np.diag(one.covariance))
    count = float(ensembles * DRAWS)
    return Posterior(
        one.frequency_hz * np.exp(logs[..., 0]),
        one.damping_ratio * np.exp(logs[..., 1]),
        (1.0, 1.0),
        (count, count),
        1.0,
        1.0,
        1.0,
        (float(sd[0] * one.frequency_hz), float(sd[1] * one.damping_ratio)),
        (settings.seed, *settings.seed_key, index),
    )


def _of_record(
    series: DisplacementSeries,
    prepared: Prepared,
    found: Spectrum,
    modes: tuple[IdentifiedMode, ...],
    failed: tuple[FailedMode, ...],
) -> Identification:
    n, k = series.values.shape
    start_s = float(series.time_s[prepared.first_row])
    end_s = start_s + float(prepared.data.time_s[-1])
    inside = (series.time_s >= start_s) & (series.time_s <= end_s)
    used, channels_used = np.zeros((n, k), dtype=bool), np.isin(np.arange(k), prepared.channels)
    used[inside] = np.isfinite(series.values[inside]) & channels_used
    residual_sd = np.full(k, np.nan)
    if prepared.projection is None:
        # White noise of this level up to half the sampling rate.
        residual_sd[prepared.channels] = found.noise_sd / np.sqrt(2.0 * found.step_s)
    notes = []
    if filled := int(np.count_nonzero(found.filled)):
        notes.append(Note.FILLED(count=filled, percent=200.0 * filled / found.filled.size))
    onset = Onset(start_s, float("nan"), start_s, "none", 1.0)
    return Identification(
        series=series,
        onset=onset,
        modes=modes,
        failed=failed,
        fitted=np.full((n, k), np.nan),
        baseline=np.full((n, k), np.nan),
        used=used,
        residual_sd=residual_sd,
        channels_used=channels_used,
        notes=(*series.notes, *prepared.notes, *notes),
        segments=(Segment("ambient", start_s, end_s),),
    )


def _curve(found: Spectrum) -> tuple[FloatArray, FloatArray]:
    """Frequencies (b,) and singular values (b, k) of the spectrum, in the units of the noise."""
    bins = max(4, 2 * int(np.ceil(found.frequency_hz.size / MOST_FREQUENCIES)))
    curve = singular_values(found, bins)
    return curve.frequency_hz, curve.values[:, :3]


def _largest(fit: BandFit) -> FloatArray:
    """Largest singular value of the fitted spectral density matrix, in the units of the noise, shape (g,)."""
    basis = np.linalg.qr(fit.data.directions)[1]
    matrix = basis @ spectrum(fit.model, fit.data) @ basis.T
    return np.asarray(np.linalg.eigvalsh(matrix)[:, -1], dtype=np.float64)


def _spectral_bands(fitted: list[_Fitted], modes: list[_Found]) -> tuple[AmbientBand, ...]:
    return tuple(
        AmbientBand(
            one.band.low_hz,
            one.band.high_hz,
            one.fit.data.frequency_hz,
            _largest(one.fit),
            sum(mode.band == one.band for mode in modes),
        )
        for one in fitted
    )
