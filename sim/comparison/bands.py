"""Bands of simulated decays: posterior draws of start, frequency and damping, and the uncertainty of the shape."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from modal_id import Identification
from sim.beam import AncfBeam, BeamProperties, BuckledBeamError, NoEquilibriumError, beam_modes
from sim.comparison.problem import DecaySetting, match_modes
from sim.damping import DampingModel
from sim.dynamics import FailedSimulation, State
from tracker import INTERVAL_SD, Failure, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Draws of a band."""

    #: [1] posterior draws simulated for a band
    #: statistics: The sd of 32 draws is known to 1 / sqrt(62) = 13 %: a 90 % bound to within about a tenth of its half
    #: width.
    draws: int = 32


TUNING = Tuning()


@dataclass(frozen=True)
class Candidate:
    """A damping model and the same model built from posterior draws of the modes that it depends on; none for no band.

    A model that is slow to simulate may have fewer draws than the others, every second or every fourth of theirs.
    """

    model: DampingModel
    draws: tuple[DampingModel, ...] = ()


@dataclass(frozen=True)
class Simulated:
    """Simulations of one candidate, in mm, shape (n, k) each.

    Attributes
    ----------
    low, high : array or None
        5 % and 95 % quantile of the draws, for a normal distribution.
    sd, shape_sd : array
        Standard deviation of the draws about `central`, 0 without draws, and due to the beam's shape.
    """

    central: FloatArray
    low: FloatArray | None
    high: FloatArray | None
    sd: FloatArray
    shape_sd: FloatArray
    note: str = ""

    def with_sd(self, sd_mm: FloatArray) -> Simulated:
        """With the band of a normal distribution about the curve."""
        reach = INTERVAL_SD * sd_mm
        return replace(self, low=self.central - reach, high=self.central + reach, sd=sd_mm)

    def with_shapes(self, setting: DecaySetting, sd_m: FloatArray) -> Simulated:
        """With the band widened by the uncertainty of the shape; `sd_m` as from `shape_sd`."""
        if not np.any(sd_m > 0.0):
            return self
        coordinate = self.central @ setting.shape / float(setting.shape @ setting.shape)
        sd = np.abs(np.outer(coordinate, sd_m))
        low = self.central if self.low is None else self.low
        high = self.central if self.high is None else self.high
        middle, wide = 0.5 * (low + high), np.hypot(0.5 * (high - low), INTERVAL_SD * sd)
        return replace(self, low=middle - wide, high=middle + wide, shape_sd=sd)


def draw_indices(size: int, count: int) -> NDArray[np.int64]:
    """Indices of `count` draws spread evenly over all."""
    return np.linspace(0, size - 1, count).astype(np.int64)


def start_draws(
    setting: DecaySetting, identification: Identification, count: int
) -> list[tuple[State, float]]:
    """Initial state and angular frequency of the target mode for posterior draws, spread evenly over its chains.

    The amplitude is correlated with frequency and damping ratio: each draw has the amplitude that fits the measured
    decay best, plus its remaining uncertainty for known frequency and damping ratio.
    """
    posterior = setting.matched.target.posterior
    # the record that the band is compared with has the same error of its rate
    frequency, ratio = posterior.frequency_in_record_hz.ravel(), posterior.damping_ratio.ravel()
    # the band is centred on the curve, which has the frequency at small amplitude
    middle_hz, middle = float(np.median(frequency)), float(np.median(ratio))
    t = setting.time_s[setting.used.any(axis=1)]
    fitted = np.exp(_exponent(middle_hz, middle) * t) if t.size else np.ones(0)
    reference = np.stack([fitted.real, -fitted.imag], axis=1)
    given = np.array([setting.coordinate.real, setting.coordinate.imag])
    sd = _coordinate_sd(setting, identification)
    rng = np.random.default_rng([*posterior.seed, count])
    starts = []
    for i in draw_indices(frequency.size, count):
        wave = np.exp(_exponent(float(frequency[i]), float(ratio[i])) * t)
        columns = np.stack([wave.real, -wave.imag], axis=1)
        best = np.linalg.lstsq(columns, reference @ given, rcond=None)[0] if t.size > 2 else given
        scattered = best + sd * rng.standard_normal(2)
        omega = float(setting.omega_rad_s[setting.at] + 2.0 * np.pi * (frequency[i] - middle_hz))
        starts.append((setting.start(complex(scattered[0], scattered[1])), omega))
    return starts


def simulate_candidates(
    setting: DecaySetting, candidates: Mapping[str, Candidate], starts: Sequence[tuple[State, float]]
) -> dict[str, Simulated | FailedSimulation]:
    """Curve and band of every candidate."""
    found: dict[str, Simulated | FailedSimulation] = {}
    for label, candidate in candidates.items():
        central = setting.simulated_mm(candidate.model)
        if isinstance(central, FailedSimulation):
            found[label] = central
            continue
        every = starts[:: max(1, len(starts) // max(1, len(candidate.draws)))]
        draws = list(zip(candidate.draws, every, strict=False))
        found[label] = _banded(central, _drawn(setting, central, candidate.model, draws))
    return found


def _drawn(
    setting: DecaySetting,
    central: FloatArray,
    model: DampingModel,
    draws: Sequence[tuple[DampingModel, tuple[State, float]]],
) -> list[FloatArray | FailedSimulation]:
    """Each draw as the curve plus its difference to the curve, both with longer steps: their errors cancel."""
    coarse = setting.coarse
    middle = coarse.simulated_mm(model) if draws else central
    if isinstance(middle, FailedSimulation):
        coarse, middle = setting, central
    runs = [coarse.simulated_mm(drawn, start, omega) for drawn, (start, omega) in draws]
    return [run if isinstance(run, FailedSimulation) else run + (central - middle) for run in runs]


def _banded(central: FloatArray, runs: Sequence[FloatArray | FailedSimulation]) -> Simulated:
    drawn = [run for run in runs if not isinstance(run, FailedSimulation)]
    lost = len(runs) - len(drawn)
    note = f"{lost} of {len(runs)} simulations for the band failed and were omitted" if lost else ""
    nothing = np.zeros_like(central)
    if len(drawn) < 2:
        return Simulated(central, None, None, nothing, nothing, note)
    # prediction interval of a normal distribution from few draws: the curve depends almost linearly on the posterior
    moved = np.stack(drawn)
    middle, spread = moved.mean(axis=0), moved.std(axis=0, ddof=1)
    reach = float(stdtrit(len(drawn) - 1, 0.95)) * np.sqrt(1.0 + 1.0 / len(drawn)) * spread
    sd = np.sqrt(np.mean((moved - central) ** 2, axis=0))
    return Simulated(central, middle - reach, middle + reach, sd, nothing, note)


def shape_sd(
    setting: DecaySetting, identification: Identification, beams: Sequence[BeamProperties]
) -> FloatArray:
    """Standard deviation of the motion of each marker over the drawn beams, per unit of the target's coordinate.

    The identified modes keep their measured frequencies for any properties, and the start is the measured one: drawn
    properties change the motion of the markers through the shapes only. Shape (k,); 0 if fewer than two of the beams
    have the mode.
    """
    columns = []
    for properties in beams:
        try:
            matched = match_modes(identification, beam_modes(AncfBeam(properties), setting.modes.count))
        except (BuckledBeamError, NoEquilibriumError):
            continue
        if isinstance(matched, Failure) or matched.target_number != setting.matched.target_number:
            continue
        share = (matched.target_coordinate / setting.matched.target_coordinate).real
        columns.append(matched.shapes[:, setting.at] * share)
    if len(columns) < 2:
        return np.zeros(setting.positions_m.size)
    return np.asarray(np.sqrt(np.mean((np.array(columns) - setting.shape) ** 2, axis=0)))


def _exponent(frequency_hz: float, damping_ratio: float) -> complex:
    return 2.0 * np.pi * frequency_hz * complex(-damping_ratio, np.sqrt(1.0 - damping_ratio**2))


def _coordinate_sd(setting: DecaySetting, identification: Identification) -> float:
    """Standard deviation of real and imaginary part of the target's coordinate for known poles."""
    used = identification.channels_used
    shape, sd = setting.shape[used], setting.matched.target.shape_sd[used]
    return 1e-3 * float(np.sqrt(np.sum((shape * np.nan_to_num(sd)) ** 2))) / float(shape @ shape)
