"""Measured modes of the beam: frequencies and shapes with their standard deviations."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from tracker import FloatArray, IntArray, checked


@dataclass(frozen=True)
class Tuning:
    """Errors of the model."""

    #: [1] relative sd of the model error of a frequency (clamp, amplitude, air) where none is given
    #: convention: Chosen; the option [updating] model_sd replaces it. That of the mesh is added for each mode.
    model_sd: float = 1e-4
    #: [1] sd of the model error of a shape, over its largest amplitude
    #: convention: Chosen, for errors of the markers' positions and of the model.
    shape_sd: float = 1e-2


TUNING = Tuning()


@dataclass(frozen=True)
class MeasuredShape:
    """Shape of a mode at some points, of arbitrary scale and sign.

    Attributes
    ----------
    positions_m : array, shape (k,)
        Distances from the clamp.
    amplitude : array, shape (k,)
        Real: the in-phase part of a measured complex shape.
    sd : array, shape (k,)
        In the unit of `amplitude`; a hundredth of the largest amplitude is added for errors of the marker positions and
        of the model. NaN counts as zero.
    """

    mode_number: int
    positions_m: FloatArray
    amplitude: FloatArray
    sd: FloatArray

    def __post_init__(self) -> None:
        if not self.positions_m.shape == self.amplitude.shape == self.sd.shape or self.amplitude.ndim != 1:
            msg = (
                "positions_m, amplitude and sd of a shape need one value per point each, "
                f"got shapes {self.positions_m.shape}, {self.amplitude.shape} and {self.sd.shape}"
            )
            raise ValueError(msg)
        if not (np.all(np.isfinite(self.amplitude)) and np.any(self.amplitude != 0.0)):
            msg = f"amplitudes of mode {self.mode_number} must be finite and not all zero"
            raise ValueError(msg)

    @cached_property
    def total_sd(self) -> FloatArray:
        """Standard deviation with the floor of a hundredth of the largest amplitude, shape (k,)."""
        floor = TUNING.shape_sd * np.max(np.abs(self.amplitude))
        return np.asarray(np.hypot(np.nan_to_num(self.sd), floor))

    def misfit(self, model: FloatArray) -> FloatArray:
        """Residual of the best multiple of the model's shape, over its standard deviation; (..., k) to the same."""
        a, b = self.amplitude / self.total_sd, model / self.total_sd
        scale = (b @ a) / np.sum(b * b, axis=-1)
        return np.asarray(b * scale[..., np.newaxis] - a)

    def misfit_slopes(self, model: FloatArray, slopes: FloatArray) -> FloatArray:
        """Derivative of `misfit` from that of the model's shape, (..., k) and (..., k, v) to (..., k, v)."""
        a, b = self.amplitude / self.total_sd, model / self.total_sd
        db = slopes / self.total_sd[:, np.newaxis]
        bb, ab = np.sum(b * b, axis=-1)[..., np.newaxis], (b @ a)[..., np.newaxis]
        scale = np.einsum("k,...kv->...v", a, db) / bb
        scale = scale - 2.0 * ab * np.einsum("...k,...kv->...v", b, db) / bb**2
        return np.asarray(db * (ab / bb)[..., np.newaxis] + b[..., np.newaxis] * scale[..., np.newaxis, :])


@dataclass(frozen=True)
class MeasuredModes:
    """Measured natural frequencies with their standard deviations, each mode once, and shapes where known.

    A standard deviation that is NaN counts as zero. `model_sd` is the relative standard deviation of the model error of
    a frequency (clamp, air), added to the measured one, which is often much smaller. `rate_sd` is that of the camera's
    frame rate, an error common to all frequencies, which `sd_hz` does not include.

    Raises
    ------
    ValueError
        If the values do not match each other.
    """

    mode_numbers: IntArray
    frequency_hz: FloatArray
    sd_hz: FloatArray
    shapes: tuple[MeasuredShape, ...] = ()
    model_sd: float = field(default_factory=lambda: TUNING.model_sd)
    rate_sd: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "frequency_hz", np.asarray(self.frequency_hz, dtype=np.float64))
        object.__setattr__(self, "sd_hz", np.nan_to_num(np.asarray(self.sd_hz, dtype=np.float64)))
        object.__setattr__(self, "mode_numbers", np.asarray(self.mode_numbers, dtype=np.int64))
        measured, sd, numbers = self.frequency_hz, self.sd_hz, self.mode_numbers
        if measured.ndim != 1 or measured.size == 0 or not measured.shape == sd.shape == numbers.shape:
            msg = (
                "frequency_hz, sd_hz and mode_numbers need one value per mode each, "
                f"got shapes {measured.shape}, {sd.shape} and {numbers.shape}"
            )
            raise ValueError(msg)
        if not np.all(np.isfinite(measured) & (measured > 0.0)) or np.any(sd < 0.0):
            msg = f"measured frequencies must be finite and positive, got {measured.tolist()} Hz"
            raise ValueError(msg)
        if np.any(numbers < 1) or np.unique(numbers).size != numbers.size:
            msg = f"mode_numbers must be 1 or more, each once; got {numbers.tolist()}"
            raise ValueError(msg)
        checked("model_sd", self.model_sd, positive=True)
        checked("rate_sd", self.rate_sd, at_least=0.0)

    @property
    def relative_sd(self) -> FloatArray:
        """Relative standard deviation of each frequency, model error included, without `rate_sd`; shape (m,)."""
        return np.asarray(np.hypot(self.sd_hz / self.frequency_hz, self.model_sd))

    @property
    def highest(self) -> int:
        """Number of the highest measured mode."""
        return max(int(self.mode_numbers.max()), *(shape.mode_number for shape in self.shapes), 1)
