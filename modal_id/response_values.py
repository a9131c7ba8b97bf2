"""Frequency response of the outputs to a measured input, with its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from modal_id.mode_values import Table
from tracker import Column, ComplexArray, FloatArray

if TYPE_CHECKING:
    import pandas as pd


_UNIT = "unit"
# Each an array of shape (f, k) of a `FrequencyResponse`; the rows of a table are its channels one after the other.
RESPONSE_COLUMNS = (
    Column(
        "channel", "", "name of the output", lambda r: np.tile(np.array(r.channels), (r.frequency_hz.size, 1))
    ),
    Column(
        "frequency_hz", "Hz", "frequency", lambda r: np.tile(r.frequency_hz[:, None], (1, len(r.channels)))
    ),
    Column("real", _UNIT, "real part of the response of the fitted modes", lambda r: r.model.real),
    Column("imaginary", _UNIT, "its imaginary part", lambda r: r.model.imag),
    Column("magnitude", _UNIT, "its modulus", lambda r: np.abs(r.model)),
    Column("magnitude_q05", _UNIT, "5 % quantile of the modulus, from the uncertainty of all parameters"),
    Column("magnitude_q95", _UNIT, "95 % quantile"),
    Column(
        "local_real",
        _UNIT,
        "real part of the local-polynomial estimate, without modes",
        lambda r: r.local.real,
    ),
    Column("local_imaginary", _UNIT, "its imaginary part", lambda r: r.local.imag),
    Column("local_sd", _UNIT, "standard deviation of each part, from the scatter about the polynomial"),
    Column("coherence", "1", "squared coherence of the output with the input in windows of 13 bins"),
    Column(
        "unit",
        "",
        "unit of the response: 1, or that of the output over that of the force",
        lambda r: np.full(r.model.shape, r.unit),
    ),
)


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
    input_lag_s : float
        By which the input was taken to be late; 0 where no lag was asked for.
    input_lag_sd_s : float
        Its standard deviation; NaN where it was not estimated.
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
    input_lag_s: float = 0.0
    input_lag_sd_s: float = float("nan")

    def to_dataframe(self) -> pd.DataFrame:
        """One row for each channel and frequency."""
        import pandas as pd  # noqa: PLC0415 - slow to import, and only tables need it

        return pd.DataFrame({one.name: np.asarray(one.of(self)).T.ravel() for one in RESPONSE_COLUMNS})

    def __repr__(self) -> str:
        low, high = self.frequency_hz[[0, -1]]
        return f"response of {', '.join(self.channels)} to {self.input_name} ({self.unit}), {low:.4g} to {high:.4g} Hz"
