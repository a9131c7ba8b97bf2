"""Density from moments, compared with sums over all samples."""

import numpy as np
import pytest
from kit.series import dirty, pole_of, series_of

from modal_id.data import prepare
from modal_id.fit import find_modes, refit
from modal_id.posterior import TiledLikelihood, determine_mode, reduce_mode
from modal_id.solve import ModeColumns, mode_functions, solve_linear


def test_reduced_density_equals_that_of_all_samples():
    """log p from moments agrees with the projection of all samples, within 5 sd of the centre."""
    model = find_modes(prepare(dirty(1, 1)).data, 8)
    mode = determine_mode(model, 0)
    density = mode.density
    positions = np.random.default_rng(0).uniform(-5, 5, (40, 2)) / np.sqrt(2)
    got = density(positions)
    others = model.fit.poles[1:]

    def chi_square(omega, zeta):
        pole = omega * (-zeta + 1j * np.sqrt(1 - zeta**2))
        columns = ModeColumns(model.data.time_s, np.concatenate([[pole], others]))
        return solve_linear(model.problem, columns).rss[0] / model.fit.linear.noise_variance[0]

    best = chi_square(*density.centre)
    nu, factor = density.noise.dof, density.noise.factor
    for position, value in zip(positions, got, strict=True):
        omega, zeta = (density.centre[i] + density.scale[i] * position[i] for i in range(2))
        drop = chi_square(omega, zeta) - best
        # The density also shifts the pole of the other mode; the coupling is below 2 % here.
        expected = -0.5 * (nu + 2) * np.log1p(drop / (nu * factor**2))
        assert value == pytest.approx(expected, abs=1e-3 * (1 + abs(expected)))


def chi_square_of_all_samples(model, mode, pole, close):
    """Residual of every sample with the derivatives by the close modes' poles as further columns of each channel."""
    data, fit = model.data, model.fit
    functions = mode_functions(data.time_s, np.concatenate([[pole], np.delete(fit.poles, mode)]))
    columns = np.column_stack([functions.real, functions.imag, model.problem.sparse[:].toarray()])
    k, v = data.values.shape[1], 2 * close.size
    rows, targets = [], []
    for channel in range(k):
        root = np.sqrt(data.weights[:, channel] / fit.linear.noise_variance[channel])[:, None]
        slopes = data.time_s[:, None] * mode_functions(data.time_s, fit.poles[close])
        slopes = slopes * fit.linear.amplitudes[close, channel]
        further = np.stack([slopes.real, slopes.imag], axis=2).reshape(data.time_s.size, v)
        basis = np.linalg.qr(root * columns)[0]
        for target, column in ((rows, root * further), (targets, root * data.values[:, [channel]])):
            target.append(column - basis @ (basis.T @ column))
    rows, targets = np.concatenate(rows), np.concatenate(targets)
    left = targets - rows @ np.linalg.lstsq(rows, targets, rcond=None)[0]
    return float(np.sum(left**2))


def test_channels_with_different_outliers_and_a_close_mode():
    """Groups of weights share their sums up to corrections; the series holds to 1e-9 of the sums it replaces."""
    rng = np.random.default_rng(3)
    t = np.arange(6000) / 500.0
    motion = [np.exp(pole_of(f, 0.004) * t + 1j * f).real for f in (12.0, 12.6)]
    values = np.outer(motion[0], [1.0, 0.6, -0.4]) + np.outer(motion[1], [0.3, -0.5, 0.8])
    values += 0.02 * rng.standard_normal(values.shape) + 0.3 * t[:, None]
    for channel in range(3):
        values[rng.choice(t.size, 8, replace=False), channel] += 1.0
    model = find_modes(prepare(series_of(t, values)).data, 8)
    assert model.fit.poles.size == 2
    assert len(model.data.groups) == 3
    close = np.array([1])
    reach = 10.0 * float(np.max(model.fit.pole_sd[0]))
    likelihood = reduce_mode(model.problem, model.fit, 0, close, reach)
    change = reach * (rng.uniform(-0.5, 0.5, 5) + 1j * rng.uniform(-0.5, 0.5, 5))
    got = likelihood.chi_square(change)
    expected = [chi_square_of_all_samples(model, 0, complex(model.fit.poles[0]) + d, close) for d in change]
    # 1e-9 of the weighted sum of squares of the data, which is 1e3 times chi-square.
    np.testing.assert_allclose(got, expected, rtol=1e-5)


@pytest.mark.parametrize(("rate_hz", "lost"), [(100.0, 0.0), (450.0, 0.003)])
def test_a_pole_that_is_hardly_determined_is_computed_in_tiles(rate_hz, lost):
    """Noise of 0.6 of the first deflection: one series would need hundreds of terms; tiles agree with all samples.

    A change of chi-square of 0.01 moves a log density by 0.005. Averages of three of the fast samples lose 0.3 % of the
    information, as the description says: of a chi-square c, 0.003 c, and by chance 2 sqrt(0.003 c), of which three sd.
    """
    rng = np.random.default_rng(1)
    t = np.arange(15 * rate_hz) / rate_hz
    values = np.exp(pole_of(6.0, 0.02) * t).real + 0.6 * rng.standard_normal(t.size)
    first = find_modes(prepare(series_of(t, np.exp(pole_of(6.0, 0.02) * t).real)).data, 1)
    model = refit(first, first.fit.poles, prepare(series_of(t, values)).data)
    reach = 10.0 * float(np.max(model.fit.pole_sd[0]))
    likelihood = reduce_mode(model.problem, model.fit, 0, np.array([], dtype=np.intp), reach)
    assert isinstance(likelihood, TiledLikelihood)
    change = reach * (rng.uniform(-1.0, 0.3, 20) + 1j * rng.uniform(-1.0, 1.0, 20))
    got = likelihood.chi_square(change) - likelihood.chi_square(np.zeros(1, dtype=complex))[0]
    pole = complex(model.fit.poles[0])
    expected = [chi_square_of_all_samples(model, 0, pole + d, np.array([], dtype=np.intp)) for d in change]
    expected = np.array(expected) - chi_square_of_all_samples(model, 0, pole, np.array([], dtype=np.intp))
    most_off = 0.01 + lost * expected + 6.0 * np.sqrt(lost * expected)
    assert np.all(np.abs(got - expected) < most_off), (got - expected) / most_off
    assert len(likelihood.tiles) > 1


def test_a_heavily_damped_pole_holds_for_waves_that_decay_much_more_slowly():
    """Ten standard deviations reach to no damping at all, where a wave lasts as long as the record."""
    rng = np.random.default_rng(2)
    t = np.arange(1600) / 100.0
    clean = np.exp(pole_of(6.0, 0.15) * t).real
    model = refit(
        first := find_modes(prepare(series_of(t, clean + 1e-4 * rng.standard_normal(t.size))).data, 1),
        first.fit.poles,
        prepare(series_of(t, clean + 0.11 * rng.standard_normal(t.size))).data,
    )
    none = np.array([], dtype=np.intp)
    pole = complex(model.fit.poles[0])
    reach = 10.0 * float(np.max(model.fit.pole_sd[0]))
    assert reach > -pole.real, "the case is one of little information"
    likelihood = reduce_mode(model.problem, model.fit, 0, none, reach)
    change = -pole.real * rng.uniform(-1.0, 0.999, 20) + 1j * reach * rng.uniform(-1.0, 1.0, 20)
    got = likelihood.chi_square(change)
    expected = [chi_square_of_all_samples(model, 0, pole + d, none) for d in change]
    # A change of chi-square of 0.01 moves a log density by 0.005.
    np.testing.assert_allclose(got, expected, atol=0.01)
