"""What frames predicted from others leave out of a motion: its mean, and the standard deviation about it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from modal_id.data import Projection
from modal_id.fit.model_order import ModalFit, refit
from tracker import ComplexArray, FloatArray, PositionErrors


@dataclass(frozen=True)
class Tuning:
    """What a codec leaves out."""

    #: [sd] amplitude, in sd of the shrinkage, below which it shrinks in proportion
    #: physics: No motion is reversed.
    least: float = 4.0


TUNING = Tuning()

# Samples at a time.
_BLOCK = 8192


@dataclass(frozen=True)
class Omissions:
    """Errors of the channels of a fit in frames predicted from others.

    ``channels``, shape (k,), are indices in the series of the channels of `model`; with `mixed`, of those that its
    components stand for.
    """

    model: ModalFit
    errors: PositionErrors
    channels: NDArray[np.intp]
    mixed: Projection | None = None

    def without_mean(self) -> ModalFit:
        """The fit to data less the mean error; unchanged where none is expected."""
        if not np.any(self.errors.shrinkage[self.channels] > 0.0):
            return self.model
        data = self.model.data
        values = data.values.copy()
        for first in range(0, data.time_s.size, _BLOCK):
            rows = slice(first, first + _BLOCK)
            values[rows] -= self.mean(rows)
        corrected = replace(data, values=np.where(data.weights > 0.0, values, data.values))
        return refit(self.model, self.model.fit.poles, corrected)

    def mean(self, rows: slice) -> FloatArray:
        """Mean error of each channel or component of the model; shape (rows, k)."""
        errors, own = self.errors, self.channels
        mean = (-errors.shrinkage[own] - 1j * errors.lag[own]) * self._waves(rows, of_mean=True)
        return np.real(self._of_components(mean))

    def sd(self, rows: slice) -> FloatArray:
        """Standard deviation of the error's amplitude, for each channel or component; shape (rows, k)."""
        errors, own = self.errors, self.channels
        # The error of all channels is one function of the amplitude.
        sd = np.hypot(errors.shrinkage_sd[own], errors.lag_sd[own]) * self._waves(rows, of_mean=False)
        return np.abs(self._of_components(sd))

    def _waves(self, rows: slice, *, of_mean: bool) -> ComplexArray:
        """Motion of each of the `channels` over its amplitude, times the share of the errors there; (rows, k).

        Of several modes each loses its part of the whole.
        """
        functions = np.ascontiguousarray(self.model.fit.linear.columns[rows]).view(np.complex128)
        amplitudes = self.model.fit.linear.amplitudes
        if self.mixed is not None:
            amplitudes = amplitudes @ self.mixed.to_channels.T
        size = np.sqrt(np.abs(functions) ** 2 @ np.abs(amplitudes) ** 2)
        steps = frame_steps(self.model, self.errors, functions, amplitudes)
        waves = (
            functions @ amplitudes / np.hypot(size, TUNING.least * self.errors.shrinkage_sd[self.channels])
        )
        for k, channel in enumerate(self.channels.tolist()):
            waves[:, k] *= self.errors.omitted(channel, steps[:, k], of_mean=of_mean)
            waves[:, k] *= self.errors.growth(channel, size[:, k])
        return np.asarray(waves)

    def _of_components(self, of_channels: ComplexArray) -> ComplexArray:
        return of_channels if self.mixed is None else of_channels @ self.mixed.from_channels.T


def frame_steps(
    model: ModalFit, errors: PositionErrors, functions: ComplexArray, amplitudes: ComplexArray
) -> FloatArray:
    """Amplitude of the change from one frame to the next; shape (n, k), of `functions` (n, m), `amplitudes` (m, k)."""
    # Of a sampled sine, whether it is aliased or not.
    turn = np.exp(1j * model.fit.poles.imag * errors.frame_s) - 1.0
    return np.asarray(np.sqrt(np.abs(functions * turn) ** 2 @ np.abs(amplitudes) ** 2))
