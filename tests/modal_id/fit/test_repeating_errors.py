"""Errors that return with the motion: intervals of the poles with them, against records made with known errors."""

from dataclasses import replace

import numpy as np
import pytest
from kit.series import errors_of_positions
from scipy.stats import chi2
from support.memory import peak_of

from modal_id.data import FitData
from modal_id.fit import find_modes, without_repeating_errors
from modal_id.fit import position_errors as fitted_errors
from modal_id.solve import damping_ratio
from tracker import position_errors

FREQUENCY, ZETA, FPS = 23.7, 0.004, 500.0
TUNING = position_errors.TUNING
POLE = 2.0 * np.pi * FREQUENCY * complex(-ZETA, np.sqrt(1.0 - ZETA**2))
SD_PX = 0.005
RECORDS = 20


def errors(channels, *, periodic=0.0, shrinkage_sd=0.0, period_px=1.0, rest_px=0.3):
    sds = {"periodic_sd": periodic * SD_PX, "shrinkage_sd": shrinkage_sd * SD_PX, "frame_s": 1.0 / FPS}
    return errors_of_positions(
        channels, rest_px=rest_px, px_per_unit=1.0, period_px=period_px, along_px=1.0, **sds
    )


def predicted_errors(channels, *, forward=False):
    lag, lag_sd = (TUNING.forward_lag, TUNING.forward_lag_sd) if forward else (0.0, TUNING.lag_sd)
    return replace(
        errors(channels, shrinkage_sd=TUNING.shrinkage_sd),
        shrinkage=np.full(channels, TUNING.shrinkage * SD_PX),
        lag=np.full(channels, lag * SD_PX),
        lag_sd=np.full(channels, lag_sd * SD_PX),
        predicted=True,
    )


def scores(frames, amplitude_px, known, disturb, records=RECORDS):
    """z of the damping without and with the errors among the unknowns, and the ratio of the two sd; for each record."""
    found = []
    for seed in range(records):
        rng = np.random.default_rng([seed, frames])
        time = np.arange(frames) / FPS
        wave = np.exp(POLE * time + 2j * np.pi * rng.uniform())
        channels = known.periodic_sd.shape[1]
        size = amplitude_px * np.linspace(1.0, 0.7, channels)
        values = size * wave.real[:, None] + SD_PX * rng.standard_normal((frames, channels))
        values += disturb(rng, wave[:, None] * size)
        model = find_modes(FitData(time, values, np.ones(values.shape)), 1)
        free = without_repeating_errors(model, known, np.arange(channels))
        plain, own = model.fit.covariance[0, 0], free.fit.covariance[0, 0] + free.repeating[0, 0]
        off = [model.fit.poles[0].real - POLE.real, free.fit.poles[0].real - POLE.real]
        found.append((off[0] / np.sqrt(plain), off[1] / np.sqrt(own), np.sqrt(own / plain)))
        assert damping_ratio(free.fit.poles[0]) == pytest.approx(ZETA, rel=0.3)
    return np.array(found).T


def assert_calibrated(z, what):
    low, high = chi2.ppf([0.0005, 0.9995], z.size)
    total = float(z @ z)
    assert low < total < high, f"{what}: {z.size} z^2 make {total:.0f}, chance allows {low:.0f} to {high:.0f}"


def template_noise(share, rest_px=0.3):
    def disturb(rng, motion):
        turn = 2.0 * np.pi * (rest_px + motion.real)
        a, b = share * SD_PX * rng.standard_normal((2, motion.shape[1]))
        return a * np.cos(turn) + b * np.sin(turn)

    return disturb


@pytest.mark.parametrize(
    ("frames", "amplitude_px"), [(1500, 0.7), pytest.param(4000, 1.0, marks=pytest.mark.slow), (1500, 5.0)]
)
def test_template_noise_does_not_make_intervals_too_narrow(frames, amplitude_px):
    known = errors(2, periodic=TUNING.lossless_share)
    plain, free, wider = scores(frames, amplitude_px, known, template_noise(TUNING.lossless_share))
    assert_calibrated(free, f"{frames} frames, {amplitude_px} px")
    # The data tell most of the error: what remains is at most as large as the noise.
    assert np.all((wider > 0.98) & (wider < 2.5)), f"the sd grows by {wider.min():.2f} to {wider.max():.2f}"
    if amplitude_px <= 1.0:
        limit = chi2.ppf(0.9995, plain.size)
        assert plain @ plain > limit, f"without the errors z^2 adds up to {plain @ plain:.0f} only"


def test_more_frames_narrow_the_interval_only_as_far_as_the_error_is_known():
    """The error of one marker at 0.3 px looks like damping; the interval keeps what it could be."""
    known = errors(1, periodic=TUNING.lossless_share)
    quiet = errors(1)
    widths = []
    for frames in (1500, 6000):
        wider = scores(frames, 0.7, known, template_noise(TUNING.lossless_share), records=8)[2]
        alone = scores(frames, 0.7, quiet, template_noise(0.0), records=2)[2]
        assert np.allclose(alone, 1.0, rtol=1e-6), "no error, no widening"
        widths.append(np.median(wider))
    assert widths[1] > 1.05 * widths[0] or min(widths) > 1.2, f"factors on the sd: {widths}"


def test_errors_over_the_blocks_of_a_codec_do_not_make_intervals_too_narrow():
    share, period = 0.3, 8.0
    known = errors(1, periodic=share, period_px=period)

    def disturb(rng, motion):
        return share * SD_PX * known_columns(motion) @ rng.standard_normal((32, 1))

    def known_columns(motion):
        return known.periodic(0, motion.real[:, 0]) / (share * SD_PX)

    _, free, _ = scores(1500, 5.0, known, disturb)
    assert_calibrated(free, "blocks of 8 px")


@pytest.mark.parametrize(
    "lost", [0.2, *(pytest.param(x, marks=pytest.mark.slow) for x in (TUNING.shrinkage, 1.0)), 1.5]
)
def test_motion_that_a_codec_leaves_out_is_inside_the_interval(lost):
    """A dead zone of constant size takes the same from every amplitude, and all markers the same."""
    known = predicted_errors(2)

    def disturb(rng, motion):
        del rng
        return -lost * SD_PX * motion.real / np.abs(motion)

    plain, free, _ = scores(1500, 0.5, known, disturb)
    bias, left = np.mean(plain), np.max(np.abs(free))
    # The dead zone differs from the expected one by this many prior sd in all records; noise adds one.
    off = abs(lost - TUNING.shrinkage) / TUNING.shrinkage_sd
    assert left < off + 3.5, f"off by {left:.1f} sd"
    assert abs(bias) > 10.0 * lost, f"without the error the damping is {bias:.1f} sd off only"


@pytest.mark.parametrize("forward", [False, True])
def test_what_predicted_frames_omit_on_average_changes_neither_damping_nor_frequency(forward):
    """Amplitude and phase are wrong by what is expected of the encoder: both poles' parts must remain unbiased.

    20 records determine a mean to 0.22 sd for noise alone, less where the interval is wider than noise makes it.
    """
    known, found = predicted_errors(1, forward=forward), []
    time = np.arange(1500) / FPS
    for seed in range(RECORDS):
        rng = np.random.default_rng([seed, 3])
        motion = 0.3 * np.exp(POLE * time + 2j * np.pi * rng.uniform())
        size, sd = np.abs(motion), known.shrinkage_sd[0] / TUNING.shrinkage_sd
        left = known.omitted(0, size * abs(np.exp(POLE / FPS) - 1.0), of_mean=True) * known.growth(0, size)
        lost = left * (known.shrinkage[0] * motion.real - known.lag[0] * motion.imag) / size
        values = motion.real - lost + sd * rng.standard_normal(time.size)
        model = find_modes(FitData(time, values[:, None], np.ones((time.size, 1))), 1)
        free = without_repeating_errors(model, known, np.arange(1))
        own = model.fit.covariance, free.fit.covariance + free.repeating
        for fit, covariance in zip((model.fit, free.fit), own, strict=True):
            off = fit.poles[0] - POLE
            found.append(np.array([off.real, off.imag]) / np.sqrt(np.diag(covariance)))
    plain, corrected = np.mean(np.array(found).reshape(RECORDS, 2, 2), axis=0)
    assert abs(plain[0]) > 3.0, "without the correction the damping is right, too"
    assert np.all(np.abs(corrected) < 3.5 / np.sqrt(RECORDS)), f"mean z of damping and frequency: {corrected}"


@pytest.mark.parametrize("lag", [-1.0, pytest.param(1.0, marks=pytest.mark.slow), 2.5])
def test_the_lag_of_frames_predicted_from_earlier_ones_is_inside_the_interval_of_the_frequency(lag):
    """A lag of constant size delays small amplitudes more: a phase that changes, which looks like a frequency."""
    known, time = predicted_errors(1, forward=True), np.arange(1500) / FPS
    found = []
    for seed in range(RECORDS):
        rng = np.random.default_rng([seed, 4])
        motion = 0.3 * np.exp(POLE * time + 2j * np.pi * rng.uniform())
        values = motion.real + SD_PX * (lag * motion.imag / np.abs(motion) + rng.standard_normal(time.size))
        model = find_modes(FitData(time, values[:, None], np.ones((time.size, 1))), 1)
        free = without_repeating_errors(model, known, np.arange(1))
        own = model.fit.covariance[1, 1], free.fit.covariance[1, 1] + free.repeating[1, 1]
        poles = model.fit.poles[0], free.fit.poles[0]
        found.append([(pole - POLE).imag / np.sqrt(v) for pole, v in zip(poles, own, strict=True)])
    plain, corrected = np.array(found).T
    off = abs(lag - TUNING.forward_lag) / TUNING.forward_lag_sd
    assert np.max(np.abs(corrected)) < off + 3.5, f"off by {np.max(np.abs(corrected)):.1f} sd"
    assert abs(np.mean(plain)) > 5.0, f"without the error the frequency is {np.mean(plain):.1f} sd off only"


def test_what_compression_takes_at_any_speed_does_not_make_intervals_too_narrow():
    """Fast motion in frames compressed one by one, its amplitude wrong by a random function of the amplitude."""
    share = 0.3
    known = errors(1, shrinkage_sd=share)

    def disturb(rng, motion):
        size = np.abs(motion)
        # Random waves over the logarithm of the amplitude, of unit variance and correlation length 0.6.
        turns = np.log(size) * (rng.standard_normal(8) / 0.6)
        a, b = rng.standard_normal((2, 8)) / np.sqrt(8.0)
        lost = np.cos(turns) @ a + np.sin(turns) @ b
        return share * SD_PX * lost[:, None] * motion.real / size

    plain, free, _ = scores(1500, 60.0, known, disturb)
    assert_calibrated(free, "18 px from frame to frame")
    assert plain @ plain > chi2.ppf(0.9995, plain.size), "without the error the intervals are wide enough"


def test_a_phase_that_is_not_that_of_the_motion_is_no_error():
    """Without any periodic or shrinkage sd the fit is unchanged to rounding."""
    plain, free, wider = scores(1500, 1.0, errors(2), template_noise(0.0))
    assert np.allclose(plain, free, atol=1e-2)
    assert np.allclose(wider, 1.0, atol=1e-6)


@pytest.mark.parametrize(("amplitude_px", "most"), [(60.0, 1.1), (0.5, np.inf)])
def test_a_fast_motion_is_not_left_out(amplitude_px, most):
    """18 px from frame to frame at first, 3 at the end: the codec follows, and what it leaves out adds little."""
    known = predicted_errors(2)

    def disturb(rng, motion):
        del rng
        step = np.abs(motion * POLE) / FPS
        lost = np.column_stack([known.omitted(k, step[:, k]) for k in range(2)])
        return -SD_PX * lost * motion.real / np.abs(motion)

    _, free, wider = scores(1500, amplitude_px, known, disturb)
    off = (1.0 - TUNING.shrinkage) / TUNING.shrinkage_sd
    assert np.max(np.abs(free)) < off + 3.5, f"off by {np.max(np.abs(free)):.1f} sd"
    # Two channels disagree by chance in some records, which widens their intervals.
    assert np.median(wider) < most, f"the sd grows by {np.median(wider):.2f}"
    if np.isinf(most):
        assert np.min(wider) > 3.0, "0.15 px from frame to frame may all be left out"


def test_the_fit_is_that_of_all_functions_at_once(monkeypatch):
    """Blocks of samples against the normal equations of dense columns; the memory is that of a few columns."""
    frames, q = 20_000, 2
    rng, time = np.random.default_rng(5), np.arange(frames) / FPS
    pole = complex(-3.0 / time[-1], POLE.imag)
    sd = SD_PX / 0.5  # of a film in which both errors can be seen
    known = replace(errors(2, periodic=0.5, period_px=8.0), periodic_sd=np.full((1, 2), 0.5 * sd))
    values = 6.0 * np.real(np.exp(pole * time))[:, None] * [1.0, 0.7] + sd * rng.standard_normal((frames, 2))
    model = find_modes(FitData(time, values, np.ones(values.shape)), 1)
    monkeypatch.setattr(fitted_errors, "_BLOCK", 1500)
    peak, found = peak_of(lambda: without_repeating_errors(model, known, np.arange(2)))

    linear, information = model.fit.linear, np.zeros((q, q))
    wave = np.exp(model.fit.poles[0] * time)
    baseline = linear.splines[:].toarray()
    motion = np.real(wave[:, None] * linear.amplitudes) + linear.baseline
    for k in range(2):
        slope = time * linear.amplitudes[0, k] * wave
        free = np.column_stack([wave.real, wave.imag, baseline])
        own = np.column_stack([slope.real, -slope.imag, known.periodic(k, motion[:, k])])
        own -= free @ np.linalg.lstsq(free, own, rcond=None)[0]
        gram = own.T @ own / linear.noise_variance[k]
        errors_only = gram[q:, q:] + np.eye(own.shape[1] - q)
        information += gram[:q, :q] - gram[:q, q:] @ np.linalg.solve(errors_only, gram[q:, :q])
    expected = np.linalg.inv(information) - model.fit.covariance
    np.testing.assert_allclose(found.repeating, expected, rtol=1e-5, atol=1e-7 * np.max(np.abs(expected)))
    columns = peak / (8.0 * frames)
    # 36 functions of each channel would be 72 columns.
    assert columns < 36.0, f"memory of {columns:.0f} values for each sample"


@pytest.mark.parametrize("spread", [0.0, 0.01])
def test_poles_that_differ_between_the_stations_of_a_line_widen_the_interval(spread):
    """Each station's damping ratio is off by a relative error: the mean's z follows Student's t of 7 degrees."""
    known, time, found = replace(errors(8), alike=True), np.arange(1500) / FPS, []
    for seed in range(RECORDS):
        rng = np.random.default_rng([seed, 77])
        own = POLE.real * (1.0 + spread * rng.standard_normal(8)) + 1j * POLE.imag
        waves = np.exp(np.multiply.outer(time, own) + 2j * np.pi * rng.uniform())
        values = waves.real + SD_PX * rng.standard_normal(waves.shape)
        model = find_modes(FitData(time, values, np.ones(values.shape)), 1)
        free = without_repeating_errors(model, known, np.arange(8))
        plain, wide = model.fit.covariance[0, 0], free.fit.covariance[0, 0] + free.repeating[0, 0]
        off = free.fit.poles[0].real - POLE.real
        found.append((off / np.sqrt(plain), off / np.sqrt(wide), np.sqrt(wide / plain)))
    alone, z, wider = np.array(found).T
    limit = chi2.ppf(0.9995, z.size)
    # The variance of Student's t of 7 degrees of freedom is 7 / 5.
    assert z @ z < 7.0 / 5.0 * limit, f"the sum of {z.size} z^2 is {z @ z:.0f}"
    if spread > 0.0:
        assert alone @ alone > limit, "without the scatter the interval would have held the truth, too"
    else:
        # A variance from 7 degrees of freedom exceeds 2.4 times the true one in 1 of 50 records.
        assert np.median(wider) < 1.2
