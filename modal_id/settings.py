"""Settings of identification: target mode, theory, onset, random streams and sampling effort."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from tracker import FloatArray, Frequency, NonNegative, Options, Positive, Settings


def _array(value: object) -> FloatArray:
    return np.asarray(value, dtype=np.float64)


class SamplerSettings(Settings):
    """Effort of emcee."""

    ensembles: int = Field(default=4, ge=4, description="Independent ensembles; R-hat needs at least 4.")
    walkers: int = Field(
        default=64,
        ge=16,
        multiple_of=2,
        description="Walkers of an ensemble: independent chains, whose likelihoods are computed together.",
    )
    burn_in_steps: int = Field(default=10, ge=0, description="Steps discarded at the start of each ensemble.")
    check_steps: int = Field(
        default=60, ge=1, description="Steps between checks of the autocorrelation time."
    )
    max_steps: int = Field(default=1000, ge=1, description="Largest number of steps after the burn-in.")
    autocorrelation_times: float = Field(
        default=50.0, gt=0.0, description="Autocorrelation times after which an ensemble is long enough."
    )
    max_r_hat: float = Field(default=1.05, gt=1.0, description="R-hat above which the mode fails.")

    @model_validator(mode="after")
    def _a_check_fits(self) -> Any:
        if self.check_steps > self.max_steps:
            msg = f"check_steps must lie in 1..max_steps = {self.max_steps}, found {self.check_steps}"
            raise ValueError(msg)
        return self


class IdentifyOptions(Options):
    """Identification: the mode that was excited, and the start of the free decay."""

    mode: Annotated[int, Field(ge=1, le=50)] | None = Field(
        default=None, description="Number of the mode that was excited, from 1.", examples=[1]
    )
    target_frequency_hz: Frequency | None = Field(
        default=None,
        description="Approximate frequency of the mode that was excited; instead of mode.",
        examples=[26.8],
    )
    reject_hz: tuple[Frequency, ...] = Field(
        default=(),
        description="Frequencies, to 1 %, of motion that is no mode of the beam, such as the hum of a lamp: it is "
        "fitted beside the modes, and not listed as one.",
        examples=[[100.0]],
    )
    add_hz: tuple[Frequency, ...] = Field(
        default=(),
        description="Frequencies, to 1 %, at which a mode is fitted although its line does not exceed the threshold of "
        "the search; it is listed only where the record determines it.",
        examples=[[57.1]],
    )
    onset_s: NonNegative | None = Field(
        default=None, description="Start of the free decay; detected when not given.", examples=[0.4]
    )
    end_s: Positive | None = Field(
        default=None,
        description="End of the part of the record that is used; the end of the decay is detected when not given.",
        examples=[8.0],
    )

    excitation: Literal["free", "ambient"] = Field(
        default="free",
        description='"free": the record holds free decays. "ambient": it holds stationary motion under random forces '
        "that are not measured, such as wind or traffic; the modes are then identified from its spectrum.",
        examples=["ambient"],
    )
    components: Annotated[int, Field(ge=0, le=100)] | None = Field(
        default=None,
        description="Number of components to which many channels are reduced for the fit; chosen from their noise "
        "for more than 16 when not given. 0 fits all channels.",
        examples=[6],
    )

    output_only: bool = Field(
        default=False,
        description="Ignore a measured input: identify the outputs as if it were unknown.",
        examples=[True],
    )

    input_lag_ms: Annotated[float, Field(ge=-1e6, le=1e6)] | Literal["auto"] | None = Field(
        default=None,
        description="Time by which a measured input is late against the outputs, in ms (negative: early), or "
        '"auto": it is estimated, with its standard deviation, to parts of a sample. Without it both have one clock.',
        examples=["auto"],
    )

    @model_validator(mode="after")
    def _ends_after_onset(self) -> Any:
        if self.onset_s is not None and self.end_s is not None and self.end_s <= self.onset_s:
            msg = f"end_s must be later than onset_s = {self.onset_s:g}, found {self.end_s:g}"
            raise ValueError(msg)
        return self


class IdentifySettings(IdentifyOptions, Settings):
    """All settings of the identification of one series; `mode` takes precedence over `target_frequency_hz`.

    Raises
    ------
    ValueError
        For a value out of range, an unknown name, or settings that contradict each other.
    """

    expected_frequencies_hz: tuple[float, ...] = Field(
        default=(),
        description="Natural frequencies of the beam from theory, in ascending order: used to number the modes.",
    )
    expected_shapes: Annotated[FloatArray, BeforeValidator(_array)] | None = Field(
        default=None,
        description="Transverse mode shapes from theory at the channels, real, shape (channels, modes): for the MAC "
        "and the numbers of the modes.",
    )
    reversed_shapes: Annotated[FloatArray, BeforeValidator(_array)] | None = Field(
        default=None,
        description="The same shapes with the clamp at the other end of the beam: to find out a clamp or positions "
        "that are given from the wrong end.",
    )
    max_modes: int = Field(default=8, ge=1, description="Largest number of modes fitted together.")
    seed: int = Field(default=0, ge=0, description="Seed of all random numbers.")
    seed_key: tuple[int, ...] = Field(
        default=(),
        description="Separates the random streams of recordings: words of the input's hash, each 0 to 2^32 - 1.",
    )
    sampler: SamplerSettings = Field(default=SamplerSettings(), description="Effort of the sampler.")

    @property
    def lowest_hz(self) -> float:
        """Frequency above which modes are looked for, well below the lowest in theory; 0 where none is given.

        Not from the target frequency: a stronger mode below it must be fitted, or it remains in the residual.
        """
        return 0.4 * min(self.expected_frequencies_hz, default=0.0)

    @property
    def target_hz(self) -> float | None:
        """Frequency of the target, from theory or as given; None where it is unknown."""
        expected, number = self.expected_frequencies_hz, self.mode
        if number is not None and number <= len(expected):
            return expected[number - 1]
        return self.target_frequency_hz

    @model_validator(mode="after")
    def _one_shape_per_frequency(self) -> Any:
        shapes, count = self.expected_shapes, len(self.expected_frequencies_hz)
        if shapes is not None and (shapes.ndim != 2 or shapes.shape[1] != count):
            msg = (
                f"expected_shapes must have one column for each of the {count} expected frequencies, found shape "
                f"{np.shape(shapes)}"
            )
            raise ValueError(msg)
        turned = self.reversed_shapes
        if turned is not None and (shapes is None or turned.shape != shapes.shape):
            given = "none" if shapes is None else str(shapes.shape)
            msg = f"reversed_shapes must have the shape of expected_shapes, {given}, found {turned.shape}"
            raise ValueError(msg)
        return self
