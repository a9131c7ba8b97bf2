"""Posterior draws of the start and the frequency of a recorded decay, and the bands of simulations with them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from modal_id.results import Identification
from sim.comparison.problem import DecaySetting
from sim.damping import DampingModel
from sim.dynamics.trajectory import FailedSimulation, State
from tracker.arrays import FloatArray

# draws per candidate, enough for a 90 % bound to within a tenth of its half width
BAND_DRAWS = 32


@dataclass(frozen=True)
class Candidate:
    """A damping model and draws of it.

    Attributes
    ----------
    model : DampingModel
    draws : tuple of DampingModel
        The same model built from posterior draws of the modes that it depends on; empty for no band. A model that is
        slow to simulate may have fewer than the others, every second or every fourth of theirs.
    """

    model: DampingModel
    draws: tuple[DampingModel, ...] = ()


@dataclass(frozen=True)
class StartDraws:
    """Initial conditions of the simulations of a band.

    Attributes
    ----------
    omega_rad_s : array, shape (draws,)
        Of the target mode.
    states : tuple of State, length draws
    """

    omega_rad_s: FloatArray
    states: tuple[State, ...]


@dataclass(frozen=True)
class Simulated:
    """Simulations of one candidate, in mm.

    Attributes
    ----------
    central : array, shape (n, k)
    low, high : array or None, shape (n, k)
        5 % and 95 % quantile of the draws, for a normal distribution.
    sd : array, shape (n, k)
        Standard deviation of the draws about `central`; 0 without draws.
    shape_sd : array, shape (n, k)
        Standard deviation due to the beam's shape.
    note : str
    """

    central: FloatArray
    low: FloatArray | None
    high: FloatArray | None
    sd: FloatArray
    shape_sd: FloatArray
    note: str = ""


def start_draws(setting: DecaySetting, identification: Identification, count: int) -> StartDraws:
    """Posterior draws of the target mode, spread evenly over its chains.

    The amplitude is correlated with frequency and damping ratio: each draw has the amplitude that fits the measured
    decay best, plus its remaining uncertainty for known frequency and damping ratio.
    """
    target = setting.matched.target
    posterior = target.posterior
    frequency, ratio = posterior.frequency_hz.ravel(), posterior.damping_ratio.ravel()
    every = draw_indices(frequency.size, count)
    # the band is centred on the curve, which has the frequency at small amplitude
    middle_hz, middle = float(np.median(frequency)), float(np.median(ratio))
    omega = setting.omega_rad_s[setting.at] + 2.0 * np.pi * (frequency[every] - middle_hz)
    t = setting.time_s[setting.used.any(axis=1)]
    fitted = np.exp(_exponent(middle_hz, middle) * t) if t.size else np.ones(0)
    sd = _coordinate_sd(setting, identification)
    rng = np.random.default_rng([*posterior.seed, count])
    states = []
    for i in every:
        wave = np.exp(_exponent(float(frequency[i]), float(ratio[i])) * t)
        columns = np.stack([wave.real, -wave.imag], axis=1)
        reference = np.stack([fitted.real, -fitted.imag], axis=1)
        given = np.array([setting.coordinate.real, setting.coordinate.imag])
        best = np.linalg.lstsq(columns, reference @ given, rcond=None)[0] if t.size > 2 else given
        scattered = best + sd * rng.standard_normal(2)
        states.append(setting.start(complex(scattered[0], scattered[1])))
    return StartDraws(omega, tuple(states))


def draw_indices(size: int, count: int) -> NDArray[np.int64]:
    """Indices of `count` draws spread evenly over all."""
    return np.linspace(0, size - 1, count).astype(np.int64)


def simulate_candidates(
    setting: DecaySetting, candidates: dict[str, Candidate], starts: StartDraws | None
) -> dict[str, Simulated | FailedSimulation]:
    """Curve and band of every candidate."""
    models, begun, omega = [], [], []
    own, own_omega = setting.start(), float(setting.omega_rad_s[setting.at])
    for candidate in candidates.values():
        models.append(candidate.model)
        begun.append(own)
        omega.append(own_omega)
        if starts is not None and candidate.draws:
            every = slice(None, None, len(starts.states) // len(candidate.draws))
            models += candidate.draws
            begun += starts.states[every][: len(candidate.draws)]
            omega += [float(value) for value in starts.omega_rad_s[every][: len(candidate.draws)]]
    moved, failed = setting.simulated_mm(models, begun, np.array(omega))
    found: dict[str, Simulated | FailedSimulation] = {}
    first = 0
    for label, candidate in candidates.items():
        count = 1 + len(candidate.draws)
        found[label] = _banded(moved[first : first + count], failed[first : first + count])
        first += count
    return found


def _banded(moved: FloatArray, failed: tuple[FailedSimulation | None, ...]) -> Simulated | FailedSimulation:
    if failed[0] is not None:
        return failed[0]
    central, drawn = moved[0], moved[1:][[failure is None for failure in failed[1:]]]
    lost = len(moved) - 1 - len(drawn)
    note = f"{lost} of {len(moved) - 1} simulations for the band failed and were omitted" if lost else ""
    nothing = np.zeros_like(central)
    if len(drawn) < 2:
        return Simulated(central, None, None, nothing, nothing, note)
    # prediction interval of a normal distribution from few draws: the curve depends almost linearly on the posterior
    middle, spread = drawn.mean(axis=0), drawn.std(axis=0, ddof=1)
    reach = float(stdtrit(len(drawn) - 1, 0.95)) * np.sqrt(1.0 + 1.0 / len(drawn)) * spread
    sd = np.sqrt(np.mean((drawn - central) ** 2, axis=0))
    return Simulated(central, middle - reach, middle + reach, sd, nothing, note)


def _exponent(frequency_hz: float, damping_ratio: float) -> complex:
    return 2.0 * np.pi * frequency_hz * complex(-damping_ratio, np.sqrt(1.0 - damping_ratio**2))


def _coordinate_sd(setting: DecaySetting, identification: Identification) -> float:
    """Standard deviation of real and imaginary part of the target's coordinate for known poles."""
    used = identification.channels_used
    shape, sd = setting.shape[used], setting.matched.target.shape_sd[used]
    return 1e-3 * float(np.sqrt(np.sum((shape * np.nan_to_num(sd)) ** 2))) / float(shape @ shape)
