r"""Quadratic aerodynamic drag, identified from one recorded decay.

With the drag ``rho c_d b / 2 |v| v`` per length, the damping ratio increases with the amplitude A of the mode,

.. math::  \zeta(A) = \zeta_0 + \frac{2}{3 \pi} \rho c_d A \int b |\varphi|^3 \, dx ,

averaged over a period of a small vibration with the mass-normalised shape phi. This converts the slope of the damping
ratio from the identification into a drag coefficient, and shows whether drag is detectable. If it is, the motion is
large, and neither the shape nor its projection on the image follows linear theory: the coefficient, the damping ratio
at small amplitude, the frequency and the initial coordinate are then fitted by simulations of the nonlinear beam to
all markers.

References
----------
Blevins, "Flow-induced vibration", 2nd ed. (1990), section 8.3 (drag of still air, averaged over a period).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from sim.beam import BeamModes
from sim.comparison.problem import TUNING as PROBLEM
from sim.comparison.problem import DecaySetting
from sim.comparison.scores import correlated_square
from sim.damping import DampingModel, GenericDamping, StillAir, WithAirDrag
from sim.dynamics import FailedSimulation
from tracker import INTERVAL_SD, Failure, FloatArray


@dataclass(frozen=True)
class Tuning:
    """When drag is fitted, and the convergence of its fit."""

    #: [sd] fitted coefficient over its sd below which only a limit is given
    #: statistics: A limit for 2.3 % of coefficients that are 0.
    sure: float = 2.0
    #: [1] points along the beam of the integral of |phi|^3
    #: physics: The midpoint rule is off by about (pi r / 200)^2 / 24 of mode r: 1e-5 of mode 1, 3e-4 of mode 5.
    points: int = 200
    #: [1] Gauss-Newton rounds; beyond, only a limit is given
    #: convention: Limits the computing time: a round simulates six decays.
    rounds: int = 8
    #: [1] times that a step is shortened before none is better
    #: convention: Chosen; the last step is 0.3^3 of the first.
    halvings: int = 4
    #: [1] factor on a step that is not better
    shortens: float = 0.3
    #: [1] gain of twice the log likelihood by another step at convergence
    #: statistics: Moves no parameter by more than a tenth of its sd.
    settled: float = 1e-2
    #: [1] the same where no shorter step is better: above it the fit has failed
    #: statistics: Moves no parameter by more than its sd.
    stuck: float = 1.0
    #: [1] finite difference, over amplitude, damping ratio and coefficient, and in rad of the phase at the end
    #: convention: Between the errors of the step (1e-7) and the curvature; chosen.
    step: float = 3e-3
    #: [1] damping ratio and coefficient below which a finite difference is not scaled down
    #: convention: Chosen: far below any measured ratio.
    smallest_ratio: float = 1e-6
    #: [1] a step leaves at least this share of damping ratio and coefficient
    #: convention: Chosen: both stay positive.
    floor: float = 1e-3
    #: [1] the first fit ends where the amplitude has fallen to this share
    #: convention: Before the phase can slip by a period where the first frequency is off; chosen.
    early_share: float = 0.3
    #: [1] largest frequency of the baseline, over the mode's
    #: physics: Below 0.5 a spline cannot follow the mode.
    slow_share: float = 0.4
    #: [Hz] largest frequency of the baseline
    #: convention: Drift of lighting, mount and temperature is slower; chosen.
    slow_hz: float = 1.0


TUNING = Tuning()


@dataclass(frozen=True)
class AirDrag:
    """Drag of still air in addition to `damping`; its coefficient is identified from the recording unless given."""

    damping: GenericDamping
    density_kg_m3: float = 1.204
    drag_coefficient: float | None = None


@dataclass(frozen=True)
class DragFit:
    """Aerodynamic drag in one recording; frequency and damping ratio are those at small amplitude.

    Attributes
    ----------
    drag_coefficient, drag_coefficient_sd, drag_coefficient_q05, drag_coefficient_q95 : float
        c_d for the width of the beam, and its 90 % interval; the standard deviation is 0 for a given coefficient.
    averaged, averaged_sd : float
        Coefficient by the averaged equation; NaN without a slope from the identification.
    noise_factor : float
        Factor on the standard deviations of white noise for the correlation of the residual.
    """

    drag_coefficient: float
    drag_coefficient_sd: float
    drag_coefficient_q05: float
    drag_coefficient_q95: float
    damping_ratio: float
    damping_ratio_sd: float
    frequency_hz: float
    frequency_sd_hz: float
    averaged: float
    averaged_sd: float
    density_kg_m3: float
    noise_factor: float


@dataclass(frozen=True, kw_only=True)
class DragLimit(Failure):
    """A recording without detectable drag, with an upper limit.

    Attributes
    ----------
    drag_coefficient_q95 : float
        95 % quantile for a flat prior over coefficients from 0 on, by the averaged equation; NaN where unknown.
    """

    drag_coefficient_q95: float = float("nan")


@dataclass(frozen=True)
class DragDecay:
    """Fitted drag, and the data that a comparison needs.

    Attributes
    ----------
    setting : DecaySetting
        With the initial coordinate, frequency and baseline of this fit.
    fitted_mm, curve_sd_mm : array, shape (n, k)
        The simulated motion, and its standard deviation from the posterior of all parameters.
    """

    fit: DragFit
    setting: DecaySetting
    fitted_mm: FloatArray
    model: DampingModel
    curve_sd_mm: FloatArray


def averaged_damping_slope(modes: BeamModes, mode_number: int, density_kg_m3: float) -> float:
    """Damping ratio per unit of drag coefficient and of modal amplitude (m kg^1/2), averaged over a period."""
    properties = modes.beam.properties
    length, points = properties.length_m, TUNING.points
    at = (np.arange(points) + 0.5) * length / points
    shape = modes.transverse_at(at)[:, mode_number - 1]
    width = properties.width_m[
        np.minimum((at / length * properties.elements).astype(int), properties.elements - 1)
    ]
    return float(2.0 / (3.0 * np.pi) * density_kg_m3 * np.sum(width * np.abs(shape) ** 3) * length / points)


def identify_drag(setting: DecaySetting, air: AirDrag, noise_sd_mm: FloatArray) -> DragDecay | DragLimit:
    """Fit the drag coefficient to a recorded decay, or give an upper limit.

    The limit stands where the slope of the damping ratio shows no drag, or the fit does not converge. `noise_sd_mm` is
    that of every sample, shape (n, k).

    Notes
    -----
    Gauss-Newton on simulations over initial coordinate (two numbers), frequency, damping ratio at small amplitude and
    drag coefficient, with flat priors. The covariance is that of white noise times the factor by which the gradient of
    the log likelihood, summed over periods and correlated within four of them, scatters more than for white noise. The
    decay determines c_d times the amplitude: an error of the scale is an error of the coefficient.
    """
    if setting.at >= len(air.damping.damping_ratio):
        return DragLimit("the damping model does not include the mode of the recording")
    per_unit = averaged_damping_slope(setting.modes, setting.at + 1, air.density_kg_m3) * abs(
        setting.coordinate
    )
    amplitude_fit = setting.matched.target.amplitude_dependence
    averaged, averaged_sd = float("nan"), float("nan")
    if amplitude_fit is not None:
        averaged, averaged_sd = amplitude_fit.zeta1 / per_unit, amplitude_fit.zeta1_sd / per_unit
    if air.drag_coefficient is None:
        if amplitude_fit is None:
            return DragLimit("the dependence of the damping ratio on the amplitude could not be determined")
        if averaged < PROBLEM.changes * averaged_sd:
            reason = "the damping ratio does not increase significantly with the amplitude"
            return DragLimit(reason, drag_coefficient_q95=_upper(averaged, averaged_sd))
    problem = _Problem(setting, air, noise_sd_mm, _nuisance(setting))
    zeta = (
        air.damping.damping_ratio[setting.at]
        if amplitude_fit is None
        else max(amplitude_fit.zeta0, TUNING.smallest_ratio)
    )
    first = np.array(
        [setting.coordinate.real, setting.coordinate.imag, setting.omega_rad_s[setting.at], zeta, averaged]
    )[: problem.count]
    fitted = problem.solve(first)
    if fitted is None:
        reason = "the fit of the drag by simulation did not converge"
        return DragLimit(reason, drag_coefficient_q95=_upper(averaged, averaged_sd))
    return _drag_decay(problem, fitted, averaged, averaged_sd)


@dataclass(frozen=True)
class _Fitted:
    parameters: FloatArray
    moved_mm: FloatArray
    slopes: FloatArray


@dataclass(frozen=True)
class _Problem:
    """Residuals over the parameters (Re c, Im c, omega, zeta0, c_d), the last omitted where it is given."""

    setting: DecaySetting
    air: AirDrag
    noise_sd_mm: FloatArray
    nuisance: FloatArray

    @property
    def count(self) -> int:
        return 5 if self.air.drag_coefficient is None else 4

    def model(self, parameters: FloatArray) -> DampingModel:
        ratios = list(self.air.damping.damping_ratio)
        ratios[self.setting.at] = float(parameters[3])
        given = self.air.drag_coefficient
        still = StillAir(self.air.density_kg_m3, float(parameters[4]) if given is None else given)
        return WithAirDrag(replace(self.air.damping, damping_ratio=tuple(ratios)), still)

    def simulated(self, rows: FloatArray) -> FloatArray | None:
        """Motion in mm for each row of parameters, shape (rows, n, k); None if one is impossible."""
        if np.any(rows[:, 2:] < 0.0) or np.any(rows[:, 3] >= 1.0):
            return None
        moved = []
        for row in rows:
            start = self.setting.start(complex(row[0], row[1]))
            run = self.setting.simulated_mm(self.model(row), start, float(row[2]))
            if isinstance(run, FailedSimulation):
                return None
            moved.append(run)
        return np.stack(moved)

    def solve(self, first: FloatArray) -> _Fitted | None:
        decay = -self.setting.exponent.real
        early = self.setting.time_s <= -np.log(TUNING.early_share) / max(decay, 1e-12)
        near = self._gauss_newton(first, self.weights(early))
        if near is None:
            return None
        return self._gauss_newton(near.parameters, self.weights(np.ones_like(early)))

    def weights(self, rows: NDArray[np.bool_]) -> FloatArray:
        setting = self.setting
        valid = setting.used & np.isfinite(setting.measured_mm) & rows[:, np.newaxis]
        return np.where(valid, 1.0 / self.noise_sd_mm, 0.0)

    def residual(self, moved_mm: FloatArray, weights: FloatArray) -> FloatArray:
        total_mm = self.setting.measured_mm + self.setting.baseline_mm
        return self.without_nuisance(np.where(weights > 0.0, total_mm - moved_mm, 0.0) * weights, weights)

    def without_nuisance(self, weighted: FloatArray, weights: FloatArray) -> FloatArray:
        """Weighted motion of each channel, orthogonal to the baseline and the other modes, shape (..., n, k)."""
        left = weighted.copy()
        for k in range(weights.shape[1]):
            basis = np.linalg.qr(self.nuisance * weights[:, k : k + 1])[0]
            left[..., k] -= (weighted[..., k] @ basis) @ basis.T
        return left

    def baseline(self, moved_mm: FloatArray, weights: FloatArray) -> FloatArray:
        """Fitted offset and drift, shape (n, k)."""
        total_mm = self.setting.measured_mm + self.setting.baseline_mm
        left = np.where(weights > 0.0, total_mm - moved_mm, 0.0) * weights
        slow = slow_columns(self.setting)
        return np.stack(
            [
                slow
                @ np.linalg.lstsq(self.nuisance * weights[:, k : k + 1], left[:, k], rcond=None)[0][
                    : slow.shape[1]
                ]
                for k in range(weights.shape[1])
            ],
            axis=1,
        )

    def _steps(self, parameters: FloatArray) -> FloatArray:
        size = TUNING.step * abs(complex(parameters[0], parameters[1]))
        angular = TUNING.step / max(float(self.setting.time_s[-1]), 1e-9)
        return np.array(
            [size, size, angular, *(TUNING.step * np.maximum(parameters[3:], TUNING.smallest_ratio))]
        )

    def _gauss_newton(self, parameters: FloatArray, weights: FloatArray) -> _Fitted | None:
        for round_ in range(TUNING.rounds):
            rows = np.vstack([parameters, parameters + np.diag(self._steps(parameters))])
            moved = self.simulated(rows)
            if moved is None:
                return None
            slopes = (moved[1:] - moved[0]) / self._steps(parameters)[:, np.newaxis, np.newaxis]
            residual = self.residual(moved[0], weights)
            design = self.without_nuisance(slopes * weights, weights).reshape(self.count, -1).T
            scale = np.linalg.norm(design, axis=0)
            if not np.all(scale > 0.0):
                return None
            step = np.linalg.lstsq(design / scale, residual.ravel(), rcond=None)[0] / scale
            gain = float(np.sum((design @ step) ** 2)) / max(
                float(np.mean(residual[weights > 0.0] ** 2)), 1e-300
            )
            if gain < TUNING.settled:
                return _Fitted(parameters, moved[0], slopes)
            better = self._shorter(parameters, step, residual, weights)
            if better is None:
                # round-off prevents a further improvement close to the optimum
                return _Fitted(parameters, moved[0], slopes) if round_ and gain < TUNING.stuck else None
            parameters = better
        return None

    def _shorter(
        self, parameters: FloatArray, step: FloatArray, residual: FloatArray, weights: FloatArray
    ) -> FloatArray | None:
        """Parameters after the step, shortened until the residual decreases."""
        before = float(np.sum(residual**2))
        for _ in range(TUNING.halvings):
            trial = parameters + step
            trial[3:] = np.maximum(trial[3:], TUNING.floor * parameters[3:])
            moved = self.simulated(trial[np.newaxis])
            if moved is not None and float(np.sum(self.residual(moved[0], weights) ** 2)) < before:
                return np.asarray(trial)
            step = TUNING.shortens * step
        return None


def slow_columns(setting: DecaySetting) -> FloatArray:
    """Cubic B-splines for an offset and a drift slower than the mode, shape (n, p)."""
    t = setting.time_s
    spacing_s = 0.5 / min(TUNING.slow_share * abs(setting.exponent) / (2.0 * np.pi), TUNING.slow_hz)
    inner = np.linspace(t[0], t[-1], max(2, int((t[-1] - t[0]) / spacing_s) + 1))
    knots = np.concatenate([[t[0]] * 3, inner, [t[-1]] * 3])
    return np.asarray(scipy.interpolate.BSpline.design_matrix(t, knots, 3).toarray())


def _nuisance(setting: DecaySetting) -> FloatArray:
    """Columns fitted in every channel: the baseline, and the other identified modes as linear decays."""
    waves = [
        np.exp(complex(rate / coordinate) * setting.time_s)
        for number, coordinate, rate in zip(
            setting.matched.numbers, setting.matched.coordinate, setting.matched.rate, strict=True
        )
        if number != setting.matched.target_number and coordinate != 0.0
    ]
    columns = [part for wave in waves for part in (wave.real, wave.imag)]
    slow = slow_columns(setting)
    return np.column_stack([slow, *columns]) if columns else slow


def _drag_decay(
    problem: _Problem, fitted: _Fitted, averaged: float, averaged_sd: float
) -> DragDecay | DragLimit:
    setting, p = problem.setting, fitted.parameters
    weights = problem.weights(np.ones(setting.time_s.size, dtype=np.bool_))
    covariance, factor = _covariance(problem, fitted, weights)
    sd = np.sqrt(np.diag(covariance))
    given = problem.air.drag_coefficient
    coefficient, coefficient_sd = (p[4], sd[4]) if given is None else (given, 0.0)
    if given is None and coefficient < TUNING.sure * coefficient_sd:
        reason = "the drag fitted by simulation is not significant"
        return DragLimit(reason, drag_coefficient_q95=_upper(coefficient, coefficient_sd))
    baseline = problem.baseline(fitted.moved_mm, weights)
    curve: FloatArray = np.einsum("ank,ab,bnk->nk", fitted.slopes, covariance, fitted.slopes)
    fit = DragFit(
        drag_coefficient=float(coefficient),
        drag_coefficient_sd=float(coefficient_sd),
        drag_coefficient_q05=float(coefficient - INTERVAL_SD * coefficient_sd),
        drag_coefficient_q95=float(coefficient + INTERVAL_SD * coefficient_sd),
        damping_ratio=float(p[3]),
        damping_ratio_sd=float(sd[3]),
        frequency_hz=float(p[2] / (2.0 * np.pi)),
        frequency_sd_hz=float(sd[2] / (2.0 * np.pi)),
        averaged=averaged,
        averaged_sd=averaged_sd,
        density_kg_m3=problem.air.density_kg_m3,
        noise_factor=factor,
    )
    return DragDecay(
        fit=fit,
        setting=replace(
            setting.with_target(complex(p[0], p[1]), float(p[2])),
            measured_mm=setting.measured_mm + setting.baseline_mm - baseline,
            baseline_mm=baseline,
        ),
        fitted_mm=fitted.moved_mm,
        model=problem.model(p),
        curve_sd_mm=np.sqrt(np.maximum(curve, 0.0)),
    )


def _covariance(problem: _Problem, fitted: _Fitted, weights: FloatArray) -> tuple[FloatArray, float]:
    """Covariance of the parameters, and the factor on the standard deviations of white noise."""
    residual = problem.residual(fitted.moved_mm, weights)
    design = problem.without_nuisance(fitted.slopes * weights, weights)
    information = np.einsum("ank,bnk->ab", design, design)
    scale = 1.0 / np.sqrt(np.diag(information))
    white = np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale)
    level = float(np.mean(residual[weights > 0.0] ** 2))
    white *= level
    score = np.einsum("ank,nk->na", design, residual)
    period_s = 2.0 * np.pi / float(fitted.parameters[2])
    period = np.floor(problem.setting.time_s / period_s).astype(np.int64)
    blocks: FloatArray = np.stack(
        [np.bincount(period, weights=column).astype(np.float64) for column in score.T], axis=1
    )
    sandwich = white @ correlated_square(blocks) @ white / level**2
    # of the last parameter, the coefficient
    factor = float(np.sqrt(max(1.0, sandwich[-1, -1] / white[-1, -1])))
    return white * factor**2, factor


def _upper(value: float, sd: float) -> float:
    """95 % quantile of a normal distribution truncated below 0."""
    if not (np.isfinite(value) and sd > 0.0):
        return float("nan")
    below = float(ndtr(-value / sd))
    return float(value + sd * ndtri(below + 0.95 * (1.0 - below)))
