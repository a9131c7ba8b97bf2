"""What identification must be told: target, theory, onset, random streams, effort."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class SamplerSettings:
    """Effort of emcee.

    Attributes
    ----------
    ensembles : int
        Independent ensembles with random streams of their own; at least 4, so that R-hat means something.
    walkers : int
        In each ensemble; even, and many, because the proposals are kernel densities of half an ensemble.
    burn_in_steps : int
        Dropped at the start of each ensemble.
    check_steps : int
        Steps between looks at the autocorrelation time.
    max_steps : int
        Budget of each ensemble after the burn-in.
    autocorrelation_times : float
        An ensemble is long enough when it has this many autocorrelation times.
    max_r_hat : float
        Above it the mode fails instead of giving a number.
    """

    ensembles: int = 4
    walkers: int = 64
    burn_in_steps: int = 15
    check_steps: int = 100
    max_steps: int = 1000
    autocorrelation_times: float = 50.0
    max_r_hat: float = 1.05

    def __post_init__(self) -> None:
        if self.ensembles < 4:
            msg = f"ensembles must be at least 4 for R-hat over ensembles, got {self.ensembles}"
            raise ValueError(msg)
        if self.walkers < 16 or self.walkers % 2:
            msg = f"walkers must be even and at least 16, got {self.walkers}"
            raise ValueError(msg)
        if not 0 < self.check_steps <= self.max_steps:
            msg = f"check_steps must lie in 1..max_steps = {self.max_steps}, got {self.check_steps}"
            raise ValueError(msg)


@dataclass(frozen=True)
class IdentifySettings:
    """What identification of one series must be told; everything may be left out.

    Attributes
    ----------
    target_number : int or None
        Number of the mode that the recording was made for, 1 first.
    target_frequency_hz : float or None
        Its frequency; the number wins where both are given and theory is there.
    expected_frequencies_hz : tuple of float
        Natural frequencies of the beam by theory, in order: for numbering.
    expected_shapes : array, shape (k, n_modes), or None
        Transverse theory shapes at the channels, real: for MAC and numbering.
    onset_s : float or None
        Start of the free decay where the user knows it.
    max_modes : int
        Most modes fitted together.
    seed : int
    seed_key : tuple of int
        Keeps recordings apart: words of the input's hash, each 0 to 2^32 - 1.
    sampler : SamplerSettings

    Raises
    ------
    ValueError
        For values that mean nothing.
    """

    target_number: int | None = None
    target_frequency_hz: float | None = None
    expected_frequencies_hz: tuple[float, ...] = ()
    expected_shapes: NDArray[np.float64] | None = None
    onset_s: float | None = None
    max_modes: int = 8
    seed: int = 0
    seed_key: tuple[int, ...] = ()
    sampler: SamplerSettings = field(default_factory=SamplerSettings)

    def __post_init__(self) -> None:
        if self.target_number is not None and self.target_number < 1:
            msg = f"target_number counts modes from 1, got {self.target_number}"
            raise ValueError(msg)
        if self.target_frequency_hz is not None and not 0.0 < self.target_frequency_hz < np.inf:
            msg = f"target_frequency_hz must be positive and finite, got {self.target_frequency_hz}"
            raise ValueError(msg)
        if self.max_modes < 1:
            msg = f"max_modes must be at least 1, got {self.max_modes}"
            raise ValueError(msg)
        if self.expected_shapes is not None:
            n_modes = len(self.expected_frequencies_hz)
            if self.expected_shapes.ndim != 2 or self.expected_shapes.shape[1] != n_modes:
                msg = (
                    f"expected_shapes must have one column for each of the {n_modes} expected frequencies, "
                    f"got shape {self.expected_shapes.shape}"
                )
                raise ValueError(msg)
