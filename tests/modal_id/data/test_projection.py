"""Many channels reduced to components: their noise, their answers beside those of all channels, and shapes."""

from dataclasses import replace

import numpy as np
import pytest
from kit.identified import in_sd
from kit.series import LENGTH_MM, cantilever_shapes, errors_of_positions, series_of, station_series
from kit.series import STATIONS_TRUTH as TRUTH
from scipy.stats import chi2

from modal_id import IdentifySettings, SamplerSettings, identify
from modal_id.data import prepare, project, rough_variance
from modal_id.fit import find_modes, without_repeating_errors
from modal_id.fit import position_errors as fitted_errors
from modal_id.modes import mac

FEW_STEPS = SamplerSettings(max_steps=100, check_steps=100)


def components_of(series, clean, components=None):
    """Components, and the components of the same series without noise."""
    found = project(prepare(series), components)
    assert found.projection is not None
    truth = (clean - clean.mean(axis=0)) @ found.projection.from_channels.T
    # the mean of a component is no motion
    used = np.all(found.data.weights > 0.0, axis=1)
    return found, truth + np.mean((found.data.values - truth)[used], axis=0)


def test_noise_of_the_components_is_white_and_uncorrelated():
    series, _, clean = station_series(60, 1)
    found, truth = components_of(series, clean)
    assert found.data.values.shape[1] == 3, "as many as the beam has modes"
    assert np.all(found.data.weights == 1.0)
    noise = found.data.values - truth
    n = noise.shape[0]
    correlation = np.corrcoef(noise.T) - np.eye(3)
    in_time = np.mean(noise[1:] * noise[:-1], axis=0) / np.var(noise, axis=0)
    # of independent samples: 1 / sqrt(n); the noise estimated for the basis adds as much
    assert np.max(np.abs(correlation)) < 5.0 * np.sqrt(2.0 / n)
    # the variance is estimated from half of the bins of a Hann window: 500 degrees of freedom, 2 / 500 / 1.5
    ratio = np.var(noise, axis=0) / rough_variance(found.data)
    assert np.max(np.abs(ratio - 1.0)) < 5.0 * np.sqrt(2.0 / 330.0), "known, also where motion hides it"
    assert np.max(np.abs(in_time)) < 4.5 / np.sqrt(n)
    # a station's motion is that of the components, to the errors of the basis: noise / sqrt(n) for each of them
    left = (truth @ found.projection.to_channels.T) - (clean - clean.mean(axis=0))
    limit = series.sd[0] * 5.0 * np.sqrt(3.0 / n) * np.max(np.abs(truth / noise.std(axis=0)))
    assert np.all(np.max(np.abs(left), axis=0) < limit)


def test_weights_of_the_components_state_what_missing_stations_cost():
    series, _, clean = station_series(60, 2)
    values = series.values.copy()
    rng = np.random.default_rng(3)
    seen = np.ones(values.shape, dtype=bool)
    for row in range(0, values.shape[0], 2):
        seen[row, rng.choice(60, 20, replace=False)] = False
    seen[7] = False
    found, truth = components_of(replace(series, values=np.where(seen, values, np.nan)), clean)
    error, weights = found.data.values - truth, found.data.weights
    assert np.all(weights[7] == 0.0)
    scarce = np.arange(values.shape[0]) % 2 == 0
    full = ~scarce & (np.arange(values.shape[0]) != 7)
    assert np.all(weights[full] == 1.0)
    assert np.all(weights[scarce] < 1.0)
    # the error of the mean subtracted, and of the basis, is that of 600 samples: 4 % of the variance in the mean of 300
    expected = np.mean(error[full] ** 2, axis=0)
    ratio = np.mean(weights[scarce] * error[scarce] ** 2, axis=0) / expected
    assert np.max(np.abs(ratio - 1.0)) < 5.0 * np.sqrt(2.0 / 600 + 2.0 / 600), ratio


def test_a_strong_outlier_beside_motion_does_not_enter_the_basis():
    # In this record, a station has an outlier of 1500 sd in the beginning, where the weakest mode is as large.
    series, _, clean = station_series(200, 111, missing=0.02, outliers=0.002)
    found, _ = components_of(series, clean)
    noise = series.values - clean
    far = np.abs(noise - np.nanmedian(noise, axis=0)) > 8.0 * series.sd
    assert np.count_nonzero(far) > 400, "0.2 % of the samples"
    assert not np.any(found.projection.data.weights[far] > 0.0)


def test_a_station_that_a_codec_repeats_does_not_decide():
    """Its samples hardly change from one to the next: less noise than its errors, by its stated sd, have."""
    series, _, _ = station_series(60, 21)
    values = series.values.copy()
    rng = np.random.default_rng(22)
    # Of each 40 samples the first, with the changes of a loop filter.
    values[:, 0] = np.repeat(values[::40, 0], 40) + 1e-3 * series.sd[0, 0] * rng.standard_normal(len(values))
    found = project(prepare(replace(series, values=values)), None)
    assert found.projection is not None
    noise_sd = np.sqrt(found.data.noise_variance)
    # Independent errors of half of the stated sd; the quieter half of the bins determines the rest to some percent.
    stated = np.sqrt((found.projection.from_channels**2) @ series.sd[0] ** 2)
    assert np.all(noise_sd > 0.5 * stated), noise_sd / stated
    # It is a component of its own, with noise of 0.001 of the stated. The others are those of the beam, as without it.
    own = np.argmax(np.abs(found.projection.from_channels[:, 0] * series.sd[0, 0] / noise_sd))
    others = np.delete(noise_sd / stated, own)
    assert np.all(np.abs(others - 1.0) < 0.15), others


def test_answers_are_those_of_all_channels():
    series, _, _ = station_series(20, 4, n=800)
    few, all_of_them = (
        identify(series, IdentifySettings(onset_s=0.0, components=c, max_modes=3, sampler=FEW_STEPS))
        for c in (None, 0)
    )
    assert "components of the 20 channels" in few.notes[0]
    assert len(few.modes) == len(all_of_them.modes) == 3
    for one, other in zip(few.modes, all_of_them.modes, strict=True):
        # The basis leaves out noise that the fit of all channels sees: they differ by a share of the sd. That share is
        # the root of the noise directions' part, 17 amplitudes with errors beside 3, of the information: below 0.5.
        assert abs(one.frequency_hz - other.frequency_hz) < 0.7 * other.frequency_sd_hz
        assert abs(one.damping_ratio - other.damping_ratio) < 0.7 * other.damping_ratio_sd
        # the noise level at the mode is estimated, to about 15 %
        assert one.frequency_sd_hz / other.frequency_sd_hz == pytest.approx(1.0, abs=0.3)
        assert mac(one.shape, other.shape) > 1.0 - 1e-6
        np.testing.assert_allclose(one.shape_sd, other.shape_sd, rtol=0.35)


def check_against_truth(found, shapes, level=1e-4):
    assert len(found.modes) == 3, found.failed
    for mode, (frequency, zeta, _), shape in zip(found.modes, TRUTH, shapes.T, strict=True):
        assert np.max(np.abs(in_sd(mode, frequency, zeta))) < 4.5, "4.5 sd"
        assert mac(mode.shape, shape) >= 0.9999
        scale = np.vdot(shape, mode.shape) / np.vdot(shape, shape)
        z = np.abs(mode.shape - scale * shape) / mode.shape_sd
        # two values a station; the noise level in the sd is pooled over 32 of them, to about 4 %
        low, high = chi2.ppf([level, 1 - level], 2 * shape.size)
        assert 0.85 * low < float(np.sum(z**2)) < 1.18 * high


def test_shapes_of_many_stations_have_bands_that_hold_theory():
    series, shapes, _ = station_series(100, 5, missing=0.02, outliers=0.002)
    found = identify(series, IdentifySettings(onset_s=0.0, sampler=FEW_STEPS))
    assert "components of the 100 channels" in found.notes[0]
    check_against_truth(found, shapes)
    # the two outermost of the record's outliers lie 5 mm from the beam
    assert np.nanmax(np.abs(np.where(found.used, series.values - found.fitted, np.nan))) < 0.5
    assert np.all(found.channels_used[10:])


@pytest.mark.slow
def test_intervals_hold_over_many_records():
    z = []
    for seed in range(40):
        series, shapes, _ = station_series(200, 100 + seed)
        found = identify(series, IdentifySettings(onset_s=0.0, seed=seed))
        check_against_truth(found, shapes, 1e-5)
        for mode, (frequency, zeta, _) in zip(found.modes, TRUTH, strict=True):
            z.append(in_sd(mode, frequency, zeta))
    square = np.mean(np.square(z), axis=0)
    # The intervals may be wide (systematic parts are added) but not narrow: chi-square of 120 values.
    assert np.all(square < chi2.ppf(1.0 - 1e-4, 120) / 120), square
    assert np.all(square > 0.1), square


def test_few_channels_and_noise_are_left_alone():
    series, _, _ = station_series(12, 6)
    prepared = prepare(series)
    assert project(prepared, None) is prepared
    assert project(prepared, 4).data.values.shape[1] == 4
    many = prepare(station_series(60, 6)[0])
    assert project(many, 0) is many
    rng = np.random.default_rng(7)
    noise = series_of(
        np.arange(600) / 100.0, rng.standard_normal((600, 40)), "mm", 1.0, np.linspace(0.0, LENGTH_MM, 40)
    )
    assert project(prepare(noise), None).projection is None
    found = identify(noise)
    assert not found


def test_correlated_noise_of_neighbours_gives_uncorrelated_components():
    series, _, clean = station_series(60, 8)
    rng = np.random.default_rng(9)
    smooth = np.exp(-0.5 * (np.subtract.outer(np.arange(60), np.arange(60)) / 1.5) ** 2)
    noise = rng.standard_normal(clean.shape) @ (smooth / np.linalg.norm(smooth, axis=0))
    series = replace(series, values=clean + series.sd * noise)
    found, truth = components_of(series, clean, components=5)
    left = found.data.values - truth
    correlation = np.corrcoef(left.T) - np.eye(5)
    assert np.max(np.abs(correlation)) < 5.0 * np.sqrt(3.0 / left.shape[0]), "known from half of the spectrum"


def test_errors_that_return_with_the_motion_average_out_as_in_a_fit_of_all_channels(monkeypatch):
    # Components cannot show how far stations disagree.
    monkeypatch.setattr(fitted_errors, "_GROUPS", 1)
    k = 24
    rng = np.random.default_rng(10)
    # Half a pixel and less of motion: the data hardly determine the periodic errors.
    rest_px = rng.uniform(100.0, 300.0, (1, k))
    sds = {"periodic_sd": 0.002, "shrinkage_sd": 0.002, "lag_sd": 0.0005}
    errors = errors_of_positions(k, rest_px=rest_px, px_per_unit=0.05, predicted=True, **sds)
    series, _, _ = station_series(k, 11, n=800, errors=errors, truth=TRUTH[:2])
    prepared = prepare(series)
    reduced = project(prepared, None)
    direct = without_repeating_errors(find_modes(prepared.data, 4), errors, np.arange(k))
    few = without_repeating_errors(find_modes(reduced.data, 4), errors, np.arange(k), reduced.projection)
    sd = np.sqrt(np.diag(direct.repeating))
    assert np.all(sd > 0.0)
    # The sum over 24 stations is the same; marginal where the fit of all channels also estimates the errors.
    np.testing.assert_allclose(np.sqrt(np.diag(few.repeating)), sd, rtol=0.3)
    limit = 1.5 * float(np.max(np.hypot(direct.fit.pole_sd.ravel(), sd)))
    np.testing.assert_allclose(few.fit.poles, direct.fit.poles, atol=limit, rtol=0.0)


@pytest.mark.parametrize("records", [6, pytest.param(12, marks=pytest.mark.slow)])
@pytest.mark.parametrize("alike", [True, False])
def test_an_error_common_to_all_stations_does_not_average_out(alike, records):
    k = 24
    errors = errors_of_positions(k, rest_px=200.3, px_per_unit=0.4, periodic_sd=0.01, alike=alike)
    (f, zeta, _), scores = TRUTH[1], []
    for seed in range(records):
        series, _, clean = station_series(k, seed, n=800, truth=TRUTH[1:2])
        moved = clean - clean.mean(axis=0)
        size = np.random.default_rng([seed, 5]).standard_normal(errors.periodic(0, moved[:, 0]).shape[1])
        common = np.stack([errors.periodic(i, moved[:, i]) @ size for i in range(k)], axis=1)
        reduced = project(prepare(replace(series, values=series.values + common)), None)
        own = without_repeating_errors(find_modes(reduced.data, 1), errors, np.arange(k), reduced.projection)
        error = own.fit.poles[0].real + 2.0 * np.pi * f * zeta
        scores.append(error / np.sqrt(own.fit.covariance[0, 0] + own.repeating[0, 0]))
    rms, limit = np.sqrt(np.mean(np.square(scores))), np.sqrt(chi2.isf(1e-3, records) / records)
    assert (rms < limit) == alike, (
        f"errors of {rms:.2f} stated sd; chi-square allows {limit:.2f} where the sd is right"
    )


def test_shapes_of_the_support_are_orthogonal():
    at = np.linspace(0.0, 1.0, 2001)
    shapes = cantilever_shapes(at)
    gram = shapes.T @ shapes / at.size
    # the integral of a mode's square is a quarter for a displacement of 1 at the tip (Blevins, table 4.8)
    assert np.diag(gram) == pytest.approx(0.25, rel=2e-3)
    assert np.max(np.abs(gram - np.diag(np.diag(gram)))) < 1e-3
