"""CPU time and memory of the identification of long records, beside least squares of Eq. 1 on the same samples."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context

import numpy as np

from benchmarks.identification_peers import least_squares
from modal_id import Identification, identify
from tracker import DisplacementSeries, FloatArray

SIZES = (78_000, 260_000)
_RATE_HZ, _CHANNELS, _NOISE_SD = 4000.0, 3, 0.02
# Frequency, damping ratio, amplitude.
_MODES = ((16.0, 0.004, 1.0), (107.0, 0.003, 0.3), (300.0, 0.002, 0.1))
_REPETITIONS = 3


@dataclass(frozen=True)
class Cost:
    """CPU seconds (the fastest of three runs) and peak memory of a process that identified one record.

    ``peer_s`` is the time of `scipy.optimize.curve_fit` with one mode and an offset for each channel: three parameters
    of the strongest mode, no other modes, no search for the part of the record that is a decay, no uncertainty beyond
    the covariance.
    """

    samples: int
    channels: int
    modes: int
    cpu_s: float
    peak_mb: float
    peer_s: float

    @property
    def ratio(self) -> float:
        """Time relative to the peer."""
        return self.cpu_s / self.peer_s


def record(samples: int, seed: int = 0) -> DisplacementSeries:
    """Three modes in three channels at 4000 samples per second, noise of a fiftieth of the largest amplitude."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(samples) / _RATE_HZ
    values = _NOISE_SD * rng.standard_normal((samples, _CHANNELS))
    for number, (frequency_hz, zeta, amplitude) in enumerate(_MODES):
        omega = 2.0 * np.pi * frequency_hz
        pole = omega * (-zeta + 1j * np.sqrt(1.0 - zeta**2))
        motion = amplitude * np.exp(pole * time_s + 0.7j * number).real
        values += motion[:, None] * rng.uniform(0.4, 1.0, _CHANNELS)
    return DisplacementSeries(
        name="long",
        time_s=time_s,
        channels=tuple("abc"),
        values=values,
        sd=np.full(values.shape, np.nan),
        unit="px",
        positions_mm=np.full(_CHANNELS, np.nan),
    )


def measured(samples: int) -> Cost:
    """Cost of one size in this process, whose memory it includes.

    Raises
    ------
    RuntimeError
        If a mode was not found within 1 % of its frequency.
    """
    series = record(samples)
    identify(record(8000))  # compiles
    seconds = []
    for _ in range(_REPETITIONS):
        start = time.process_time()
        found = identify(series)
        seconds.append(time.process_time() - start)
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    modes = found.modes if isinstance(found, Identification) else ()
    for frequency_hz, _, _ in _MODES:
        if not any(abs(mode.frequency_hz / frequency_hz - 1.0) < 0.01 for mode in modes):
            msg = f"the mode of {frequency_hz:g} Hz was not found in {samples} samples: {found}"
            raise RuntimeError(msg)
    peer_s = min(_timed(lambda: _peer(series.time_s, series.values)) for _ in range(_REPETITIONS))
    return Cost(samples, _CHANNELS, len(modes), min(seconds), peak_mb, peer_s)


def costs(sizes: tuple[int, ...]) -> list[Cost]:
    """Cost of each size, each in a process of its own."""
    found = []
    for samples in sizes:
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            found.append(pool.submit(measured, samples).result())
    return found


def lines(rows: list[dict[str, float]]) -> list[str]:
    """Text of the fields and the ratio of each `Cost`."""
    return [
        f"{row['samples']:8.0f} samples of {row['channels']:.0f} channels: {row['cpu_s']:6.2f} CPU s, "
        f"{row['peak_mb']:5.0f} MB; curve_fit of one mode in each channel {row['peer_s']:6.2f} CPU s, ratio "
        f"{row['ratio']:.1f}"
        for row in rows
    ]


def _peer(time_s: FloatArray, values: FloatArray) -> None:
    for channel in range(values.shape[1]):
        least_squares(time_s, values[:, channel], _MODES[0][0])


def _timed(call: Callable[[], None]) -> float:
    start = time.process_time()
    call()
    return time.process_time() - start
