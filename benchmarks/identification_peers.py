"""Other methods for identifying a damping ratio from a decay. Each takes evenly sampled values and a target frequency.

Missing samples are interpolated, as users of these methods do. Each returns the frequency in Hz, zeta and the limits
of its own 90 % interval of zeta, NaN if it reports none.
"""

from __future__ import annotations

import contextlib
import io
import logging
import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import curve_fit
from scipy.signal import butter, decimate, find_peaks, hilbert, sosfiltfilt

from tracker import INTERVAL_SD, FloatArray

_NONE = (float("nan"), float("nan"))


@dataclass(frozen=True)
class Answer:
    """Frequency and damping ratio found by a method."""

    frequency_hz: float
    zeta: float
    interval: tuple[float, float] = _NONE


Peer = Callable[[FloatArray, FloatArray, float], Answer]


def filled(time_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Interpolate to even times at the median step; fills missing samples."""
    good = np.isfinite(values)
    even = np.arange(time_s[0], time_s[-1], float(np.median(np.diff(time_s))))
    return even, np.interp(even, time_s[good], values[good])


def _line(time_s: FloatArray, logarithm: FloatArray) -> tuple[float, float]:
    """Slope of a straight line and its standard deviation."""
    (slope, _), covariance = np.polyfit(time_s, logarithm, 1, cov=True)
    return float(slope), float(np.sqrt(covariance[0, 0]))


def _from_decay(frequency_hz: float, rate: float, sd: float) -> Answer:
    """Convert the damped frequency and the decay rate of the envelope, with its standard deviation."""
    omega_d = 2.0 * np.pi * frequency_hz
    zeta = rate / np.hypot(rate, omega_d)
    half = INTERVAL_SD * sd / omega_d
    return Answer(np.hypot(rate, omega_d) / (2.0 * np.pi), zeta, (zeta - half, zeta + half))


def log_decrement(time_s: FloatArray, values: FloatArray, expected_hz: float) -> Answer:
    """Linear regression of the logarithm of the peaks above 0.3 of the highest, which noise biases least at 40 dB."""
    step = time_s[1] - time_s[0]
    centred = values - np.mean(values)
    peaks, _ = find_peaks(centred, distance=max(1, int(0.7 / (expected_hz * step))))
    half = max(1, int(0.16 / (expected_hz * step)))
    peaks = peaks[(peaks >= half) & (peaks < centred.size - half)]
    offsets = np.arange(-half, half + 1)
    # A parabola over a third of a cycle gives each peak; the highest sample alone is biased by noise.
    curvature, slope, level = np.polyfit(offsets, np.stack([centred[peaks + k] for k in offsets]), 2)
    with np.errstate(divide="ignore", invalid="ignore"):
        after, height = -0.5 * slope / curvature, level - 0.25 * slope**2 / curvature
    # Noise at the start of the record can pass for a peak; its parabola has its vertex elsewhere.
    peak = (curvature < 0.0) & (np.abs(after) <= half)
    good = peak & (height > 0.3 * np.max(height[peak]))
    peak_s = time_s[peaks] + after * step
    rate, sd = _line(peak_s[good], np.log(height[good]))
    return _from_decay((np.count_nonzero(good) - 1) / float(np.ptp(peak_s[good])), -rate, sd)


def hilbert_envelope(time_s: FloatArray, values: FloatArray, expected_hz: float) -> Answer:
    """Linear regression of the logarithm of the analytic signal's modulus after a band-pass filter of +-30 %."""
    rate = 1.0 / (time_s[1] - time_s[0])
    band = butter(
        2, (0.7 * expected_hz, min(1.3 * expected_hz, 0.49 * rate)), "bandpass", fs=rate, output="sos"
    )
    analytic = hilbert(sosfiltfilt(band, values - np.mean(values)))
    edge = int(2.0 * rate / expected_hz)
    inside = slice(edge, -edge)
    modulus, t = np.abs(analytic)[inside], time_s[inside]
    above = modulus > 0.1 * modulus[0]
    slope, sd = _line(t[above], np.log(modulus[above]))
    phase = np.unwrap(np.angle(analytic))[inside]
    return _from_decay(np.polyfit(t[above], phase[above], 1)[0] / (2.0 * np.pi), -slope, sd)


def eq1_curve(time_s: FloatArray, frequency: float, zeta: float, a: float, b: float, c: float) -> FloatArray:
    """Eq. 1 with an offset."""
    omega = 2.0 * np.pi * frequency
    angle = omega * np.sqrt(max(1.0 - zeta**2, 0.0)) * time_s
    return np.asarray(np.exp(-zeta * omega * time_s) * (a * np.cos(angle) + b * np.sin(angle)) + c)


def _spectral_peak(time_s: FloatArray, values: FloatArray, expected_hz: float) -> float:
    frequency = np.fft.rfftfreq(4 * values.size, time_s[1] - time_s[0])
    power = np.abs(np.fft.rfft(values - np.mean(values), 4 * values.size))
    near = np.abs(frequency / expected_hz - 1.0) < 0.2
    return float(frequency[near][np.argmax(power[near])])


def least_squares(time_s: FloatArray, values: FloatArray, expected_hz: float) -> Answer:
    """scipy.optimize.curve_fit of Eq. 1 with an offset."""
    start = (_spectral_peak(time_s, values, expected_hz), 0.003, values[0], 0.0, float(np.mean(values)))
    found, covariance = curve_fit(eq1_curve, time_s, values, p0=start)
    half = INTERVAL_SD * float(np.sqrt(covariance[1, 1]))
    return Answer(float(found[0]), float(found[1]), (found[1] - half, found[1] + half))


def era(time_s: FloatArray, values: FloatArray, expected_hz: float) -> Answer:
    """Eigensystem realisation (Juang & Pappa 1985) of order 2, on the record decimated to 12 samples per cycle."""
    step = time_s[1] - time_s[0]
    stride = max(1, int(1.0 / (12.0 * expected_hz * step)))
    thin = (values - np.mean(values))[::stride][:1200]
    rows = thin.size // 2
    hankel = np.lib.stride_tricks.sliding_window_view(thin, rows)
    u, s, vt = np.linalg.svd(hankel[:-1], full_matrices=False)
    root = 1.0 / np.sqrt(s[:2])
    poles = np.linalg.eigvals((root[:, None] * u[:, :2].T) @ hankel[1:] @ (vt[:2].T * root))
    lam = np.log(poles[np.argmax(poles.imag)].astype(complex)) / (stride * step)
    return Answer(float(abs(lam)) / (2.0 * np.pi), float(-lam.real / abs(lam)))


def ssi_cov(time_s: FloatArray, values: FloatArray, expected_hz: float) -> Answer:
    """pyOMA2's covariance-driven subspace identification with its uncertainty, on the record at 12 samples per cycle.

    The lowest order from 4 on with a pole near the frequency counts: at order 2, an offset displaces the pole.
    """
    from pyoma2.algorithms import SSI  # noqa: PLC0415 - optional dependency
    from pyoma2.setup import SingleSetup  # noqa: PLC0415

    logging.disable(logging.INFO)
    thin, step = _thinned(values - np.mean(values), time_s[1] - time_s[0], expected_hz)
    checks = {"xi_max": 0.2, "mpc_lim": None, "mpd_lim": None, "CoV_max": None}
    setup = SingleSetup(thin[:, None], fs=1.0 / step)
    setup.add_algorithms(SSI(name="ssi", method="cov", br=60, ordmax=8, hc=checks, calc_unc=True, nb=10))
    with contextlib.redirect_stderr(io.StringIO()), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        setup.run_by_name("ssi")
    result = setup["ssi"].result
    near = np.abs(result.Fn_poles / expected_hz - 1.0) < 0.05
    for order in range(4, near.shape[1]):
        if np.any(near[:, order]):
            row = int(np.flatnonzero(near[:, order])[0])
            zeta, half = (
                float(result.Xi_poles[row, order]),
                INTERVAL_SD * float(result.Xi_poles_std[row, order]),
            )
            return Answer(float(result.Fn_poles[row, order]), zeta, (zeta - half, zeta + half))
    msg = "no pole within 5 % of the frequency"
    raise ValueError(msg)


def _thinned(values: FloatArray, step_s: float, expected_hz: float) -> tuple[FloatArray, float]:
    """Low-pass filtered and decimated to at least 12 samples per cycle, and the new step."""
    stride = max(1, int(1.0 / (12.0 * expected_hz * step_s)))
    while stride > 1:
        # Larger factors in one stage would need very long filters.
        factor = min(stride, 10)
        values, step_s, stride = decimate(values, factor, ftype="fir"), factor * step_s, stride // factor
    return values, step_s


def ema_lscf(time_s: FloatArray, values: FloatArray, expected_hz: float) -> Answer:
    """SDyPy-EMA's least-squares complex frequency method, with the spectrum of the record as receptance."""
    from sdypy import EMA  # noqa: PLC0415 - optional dependency

    step = time_s[1] - time_s[0]
    spectrum = np.fft.rfft(values - np.mean(values)) * step
    frequency = np.fft.rfftfreq(values.size, step)
    quiet = io.StringIO()
    with contextlib.redirect_stdout(quiet), contextlib.redirect_stderr(quiet), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = EMA.Model(
            spectrum[None, :], frequency, lower=0.5 * expected_hz, upper=1.5 * expected_hz, pol_order_high=20
        )
        model.get_poles(show_progress=False)
        model.select_closest_poles([expected_hz], f_window=max(1, int(0.1 * expected_hz)))
    return Answer(float(model.nat_freq[0]), float(model.nat_xi[0]))


PEERS: tuple[tuple[str, Peer], ...] = (
    ("log decrement", log_decrement),
    ("Hilbert envelope", hilbert_envelope),
    ("curve_fit of Eq. 1", least_squares),
    ("ERA", era),
    ("pyOMA2 SSI-cov", ssi_cov),
    ("SDyPy-EMA LSCF", ema_lscf),
)
