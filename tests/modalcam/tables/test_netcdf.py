"""What ArviZ reads from the file of a posterior, against the samples that it comes from."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from kit.runs import run_result
from kit.series import pole_of, series_of
from scipy.interpolate import BSpline

from modal_id import identify
from modalcam.pipeline import RecordingResult
from modalcam.tables import netcdf
from tracker import Failure

xr = pytest.importorskip("xarray", reason="xarray is not installed")
az = pytest.importorskip("arviz", reason="ArviZ is not installed")

FREQUENCY_HZ, DAMPING_RATIO, RATE_SD_PPM = 12.0, 0.004, 50.0
# highest frequency of the drift that is fitted beside a mode above 2.5 Hz
DRIFT_HZ = 1.0
NAMES = ("tip", "\u03b6", "x" * 40)


@pytest.fixture(scope="module")
def found():
    """One mode in three channels; the frame rate is known to 50 ppm, by which the draws are widened."""
    time_s = np.arange(900) / 150.0
    wave = np.exp(pole_of(FREQUENCY_HZ, DAMPING_RATIO) * time_s).real
    noise = np.random.default_rng(0).normal(0.0, [0.01, 0.02, 0.01], (time_s.size, 3))
    series = series_of(time_s, np.outer(wave, [1.0, 0.5, -0.3]) + noise)
    series.values[40, 1] = np.nan
    return identify(replace(series, channels=NAMES, rate_sd_ppm=RATE_SD_PPM))


@pytest.fixture(scope="module")
def data(found, tmp_path_factory):
    path = tmp_path_factory.mktemp("posterior") / "take.nc"
    netcdf.write_posterior(path, found, "take")
    return az.from_netcdf(path)


def chi_square(observed, residual_sd, frequency_hz, damping_ratio):
    """Least squares of the wave and of splines up to `DRIFT_HZ` in each channel, by the noise that the fit found."""
    time_s = observed.time.to_numpy()
    wave = np.exp(pole_of(frequency_hz, damping_ratio) * (time_s - time_s[0]))
    start, end = time_s[[0, -1]]
    knots = np.linspace(start, end, int(2.0 * DRIFT_HZ * (end - start)) + 1)
    drift = BSpline.design_matrix(time_s, np.r_[[start] * 3, knots, [end] * 3], 3).toarray()
    columns = np.column_stack([wave.real, wave.imag, drift])
    total = 0.0
    for column, sd in zip(observed.series.to_numpy().T, residual_sd, strict=True):
        seen = np.isfinite(column)
        left = column[seen] - columns[seen] @ np.linalg.lstsq(columns[seen], column[seen], rcond=None)[0]
        total += float(left @ left) / sd**2
    return total


def test_the_log_likelihood_is_that_of_the_samples_in_the_file(found, data):
    """Student's t in the increase of chi-square, as docs/files.md says."""
    stats = data.sample_stats.isel(mode=0)
    draws = np.column_stack(
        [stats[name].to_numpy().ravel() for name in ("sampled_frequency_hz", "sampled_damping_ratio")]
    )
    stored = data.log_likelihood.series.isel(mode=0).to_numpy().ravel()
    some = np.linspace(0, stored.size - 1, 25).astype(int)
    squares = np.array([chi_square(data.observed_data, found.residual_sd, *draws[i]) for i in some])
    nu, factor = float(stats.noise_dof), float(stats.noise_factor)
    best = int(np.argmax(stored))
    least = chi_square(data.observed_data, found.residual_sd, *draws[best])
    increase = squares - least + nu * factor**2 * np.expm1(-2.0 * stored[best] / (nu + 2.0))
    expected = -0.5 * (nu + 2.0) * np.log1p(increase / (nu * factor**2))
    assert np.ptp(expected) > 1.0, "the draws chosen must differ in their likelihood"
    # The series of moments that replaces the samples holds to 1e-9 of a chi-square of 2700.
    np.testing.assert_allclose(stored[some], expected, rtol=0, atol=1e-5, err_msg="from the samples")


def test_sampled_draws_lack_the_error_of_the_frame_rate_that_the_posterior_has(data):
    sampled = float(data.sample_stats.sampled_frequency_hz.std())
    widened = float(data.posterior.frequency_hz.std())
    expected = np.hypot(sampled, 1e-6 * RATE_SD_PPM * FREQUENCY_HZ)
    # Two independent parts, whose chance correlation in 15 000 draws has an sd of 0.008.
    assert widened == pytest.approx(expected, rel=0.02)
    assert widened > 1.5 * sampled
    np.testing.assert_array_equal(data.sample_stats.lp, data.log_likelihood.series)


def test_observed_data_are_the_samples_used_with_their_names(found, data):
    observed = data.observed_data
    assert tuple(observed.channel.to_numpy()) == NAMES
    assert found.channels_used.all()
    kept = observed.series.to_numpy()
    rows = np.searchsorted(found.series.time_s, observed.time.to_numpy())
    assert np.isnan(kept[list(rows).index(40), 1]), "a missing sample is missing"
    seen = np.isfinite(kept)
    np.testing.assert_array_equal(seen, found.used[rows])
    np.testing.assert_array_equal(kept[seen], found.series.values[rows][seen])


def test_a_long_series_is_left_out_of_the_file(found, tmp_path, monkeypatch):
    monkeypatch.setattr("modalcam.pipeline.draws.MOST_OBSERVED", 100)
    netcdf.write_posterior(tmp_path / "take.nc", found, "take")
    assert "observed_data" not in az.from_netcdf(tmp_path / "take.nc").groups()
    whole = tmp_path / "whole.nc"
    monkeypatch.undo()
    netcdf.write_posterior(whole, found, "take")
    assert (tmp_path / "take.nc").stat().st_size < whole.stat().st_size


def test_a_run_gives_arviz_what_the_files_hold(found, data):
    done = RecordingResult("take", "take.avi", "00", None, identification=found)
    failed = RecordingResult("other", "other.avi", "00", None, identification=Failure("no mode"))
    tree = run_result((done, failed)).to_xarray()
    assert list(tree.children) == ["take"]
    given = az.from_datatree(tree["take"])
    assert set(given.groups()) == set(data.groups())
    for group in data.groups():
        # NetCDF turns names of channels from strings of fixed length into any; the values are equal.
        xr.testing.assert_equal(given[group], data[group])
        assert given[group].attrs.items() >= {"recording": "take", "inference_library": "emcee"}.items()


def test_a_tree_without_xarray_names_it(found, monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    done = RecordingResult("take", "take.avi", "00", None, identification=found)
    with pytest.raises(ImportError, match="pip install xarray"):
        run_result((done,)).to_xarray()


def test_without_sampled_draws_there_is_the_posterior_only(found, tmp_path):
    mode = found.modes[0]
    bare = replace(mode, posterior=replace(mode.posterior, sampled=None))
    netcdf.write_posterior(tmp_path / "take.nc", replace(found, modes=(bare,)), "take")
    assert set(az.from_netcdf(tmp_path / "take.nc").groups()) == {"posterior", "observed_data"}
