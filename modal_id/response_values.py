"""Frequency response of the outputs to a measured input, with its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from modal_id.mode_values import Table
from tracker import ComplexArray, FloatArray

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, repr=False, eq=False)
class FrequencyResponse(Table):
    """Transmissibility (input of the outputs' own kind) or receptance (force) by two methods.

    Attributes
    ----------
    frequency_hz : array, shape (f,)
    channels : tuple of str
        Outputs, k of them.
    input_name : str
    unit : str
        Of the response: that of the outputs over that of the input.
    model : complex array, shape (f, k)
        Of the fitted modes, with quasi-static terms of the modes beyond the band.
    magnitude_q05, magnitude_q95 : array, shape (f, k)
        Central 90 % interval of its modulus, from draws of poles and coefficients.
    local : complex array, shape (f, k)
        Local-polynomial estimate, without a model of modes; NaN where the input has too little power.
    local_sd : array, shape (f, k)
        Standard deviation of the real and of the imaginary part of it.
    coherence : array, shape (f, k)
        Squared coherence of output and input in windows of neighbouring bins, 0 to 1; 1 - coherence contains the error
        of the estimate's resolution beside the noise.
    """

    frequency_hz: FloatArray
    channels: tuple[str, ...]
    input_name: str
    unit: str
    model: ComplexArray
    magnitude_q05: FloatArray
    magnitude_q95: FloatArray
    local: ComplexArray
    local_sd: FloatArray
    coherence: FloatArray

    def to_dataframe(self) -> pd.DataFrame:
        """One row for each channel and frequency."""
        import pandas as pd  # noqa: PLC0415 - slow to import, and only tables need it

        f, k = self.model.shape
        columns = {
            "channel": np.repeat(np.array(self.channels), f),
            "frequency_hz": np.tile(self.frequency_hz, k),
            "real": self.model.real.T.ravel(),
            "imaginary": self.model.imag.T.ravel(),
            "magnitude": np.abs(self.model).T.ravel(),
            "magnitude_q05": self.magnitude_q05.T.ravel(),
            "magnitude_q95": self.magnitude_q95.T.ravel(),
            "local_real": self.local.real.T.ravel(),
            "local_imaginary": self.local.imag.T.ravel(),
            "local_sd": self.local_sd.T.ravel(),
            "coherence": self.coherence.T.ravel(),
        }
        return pd.DataFrame(columns)

    def __repr__(self) -> str:
        low, high = self.frequency_hz[[0, -1]]
        return f"response of {', '.join(self.channels)} to {self.input_name} ({self.unit}), {low:.4g} to {high:.4g} Hz"
