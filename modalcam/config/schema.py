"""Sections and keys of `experiment.toml`: each key is one field with its description, limits and example.

`modalcam init`, docs/configuration.md and the help texts of the command line are generated from these fields.
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    BeforeValidator,
    Field,
    SerializerFunctionWrapHandler,
    ValidationError,
    model_serializer,
    model_validator,
)

from modal_id import IdentifyOptions
from modalcam.common import ConfigError
from modalcam.config.beam import BeamConfig, position_problem
from sim.damping import selectable_damping_models
from tracker import CameraOptions, Finite, MarkerOptions, NonNegative, Options, Point, Positive, problems


def _file_name(value: object) -> str:
    if not isinstance(value, str) or not value:
        msg = f"expected the name of a file, found {value!r}"
        raise ValueError(msg)
    return value


def _damping_model(value: object) -> str:
    known = selectable_damping_models()
    if value not in known:
        close = difflib.get_close_matches(str(value), known, n=1)
        msg = f"expected a damping model, one of {', '.join(close or known)}; found {value!r}"
        raise ValueError(msg)
    return str(value)


def _known_models(schema: dict[str, Any]) -> None:
    schema["items"]["enum"] = list(selectable_damping_models())


DampingModelKey = Annotated[str, BeforeValidator(_damping_model)]


class LensConfig(Options):
    """A lens as `modalcam calibrate` writes it; the standard deviations are for information only."""

    width_px: Annotated[int, Field(gt=0)]
    height_px: Annotated[int, Field(gt=0)]
    focal_px: tuple[Positive, Positive]
    centre_px: Point
    distortion: tuple[Finite, Finite, Finite, Finite, Finite]
    rms_px: NonNegative | None = None
    focal_sd_px: tuple[NonNegative, NonNegative] | None = None
    centre_sd_px: tuple[NonNegative, NonNegative] | None = None
    distortion_sd: tuple[NonNegative, ...] | None = None
    pictures: int | None = None


def given_in(options: BaseModel) -> dict[str, Any]:
    """Options that were given, without defaults."""
    return {key: value for key, value in options if key in options.model_fields_set and value is not None}


class CameraConfig(CameraOptions):
    """Camera: recorded rate, scale and exposure."""

    # The content of the file replaces its name when the configuration is loaded.
    lens: LensConfig | str | None = Field(
        default=None,
        description="Lens distortion: name of a file written by `modalcam calibrate`, relative to the configuration.",
        examples=["camera.toml"],
    )


def camera_given(values: dict[str, Any], prefix: str = "") -> CameraConfig:
    """The options of the camera that are not None; ConfigError, its keys after `prefix`, if one cannot be used."""
    try:
        return CameraConfig(**{name: value for name, value in values.items() if value is not None})
    except ValidationError as error:
        msg = "; ".join(f"{prefix}{problem}" for problem in problems(error, CameraConfig))
        raise ConfigError(msg) from None


class MarkersConfig(MarkerOptions):
    """Markers: their kind, size and position on the beam."""


class DampingConfig(Options):
    """Damping models that are compared with each recording."""

    models: Annotated[tuple[DampingModelKey, ...], Field(min_length=1)] = Field(
        default=("generic", "rayleigh", "rayleigh_constant_k"),
        description="Damping models to simulate; the others are scored against the first.",
        json_schema_extra=_known_models,
    )

    @model_validator(mode="after")
    def _each_model_once(self) -> DampingConfig:
        if len(set(self.models)) < len(self.models):
            msg = f"expected each damping model once, found {', '.join(self.models)}"
            raise ValueError(msg)
        return self


class AirConfig(Options):
    """Air around the beam; its quadratic drag is one of the damping models that are compared."""

    density_kg_m3: Positive = Field(default=1.204, description="Density of the air.")
    drag_coefficient: NonNegative | Literal["identify"] = Field(
        default="identify",
        description='Drag coefficient. "identify" fits it where the damping ratio rises with the amplitude; a number '
        "is used unchanged; 0 omits drag from the comparison.",
    )


class UpdatingConfig(Options):
    """Updating: prior assumptions about the beam."""

    bound: float = Field(
        default=0.10,
        gt=0.0,
        le=0.5,
        description="Largest relative change of widths, thicknesses, density and modulus: two standard deviations of "
        "the prior.",
    )
    correlation_length: float = Field(
        default=0.1,
        ge=0.02,
        le=100.0,
        description="Correlation length of widths and thicknesses along the beam, in lengths of the beam.",
    )
    model_sd: float = Field(
        default=1e-4,
        ge=1e-6,
        le=0.1,
        description="Relative standard deviation of the discrepancy between a frequency of the beam and of its model.",
    )
    point_mass: bool = Field(
        default=False, description="Look for one point mass that [beam] lacks; a small bound helps."
    )
    clamp: bool = Field(default=False, description="Look for the stiffnesses of an elastic clamp.")


class PlanConfig(Options):
    """Planned experiment, evaluated by `modalcam plan`; `modalcam run` ignores this section."""

    modes: Annotated[tuple[Annotated[int, Field(ge=1, le=20)], ...], Field(min_length=1)] = Field(
        default=(1, 2, 3, 4, 5), description="Numbers of the modes to be excited."
    )
    tip_amplitude_mm: tuple[Positive, ...] | None = Field(
        default=None,
        description="Amplitude of the tip at the onset: one number for all modes, or one for each.",
        examples=[[10.0, 2.5, 1.1, 0.6, 0.4]],
    )
    damping_ratio: tuple[Annotated[float, Field(gt=0.0, lt=0.5)], ...] | None = Field(
        default=None,
        description="Damping ratio: one number for all modes, or one for each.",
        examples=[[0.003]],
    )
    decay_s: Positive | None = Field(
        default=None,
        description="Recorded length of each decay; chosen from the damping when not given.",
        examples=[5.0],
    )
    read_noise_sd: float = Field(
        ge=0.0,
        le=65535.0,
        default=1.5,
        description="Standard deviation of the camera's read noise, in counts.",
    )
    noise_gain: float = Field(
        ge=0.0,
        le=65535.0,
        default=0.05,
        description="Variance of the shot noise per count of signal, in counts.",
    )
    lens_blur_px: float = Field(
        default=0.6, ge=0.1, le=10.0, description="Standard deviation of the lens blur."
    )
    bit_depth: int = Field(default=8, ge=8, le=16, description="Bits per pixel of the camera.")


class _FileOptions(Options):
    # Any text: names on disk need not be valid UTF-8, which pydantic's own text must be.
    file: Annotated[Any, BeforeValidator(_file_name)] = Field(
        description="Path of the recording, relative to the folder of recordings.", examples=["take_a.avi"]
    )
    leave_out: bool = Field(
        default=False, description="Leave the recording out of runs on its folder.", examples=[True]
    )
    input_file: str | None = Field(
        default=None,
        description="Table of a measured input, such as the force of a hammer, at its own rate; path from the folder "
        "of the recording. Its time 0 is that of the first frame, but for input_lag_ms.",
        examples=["hammer.csv"],
    )
    input_column: str | None = Field(
        default=None,
        description="Column of input_file that is the input; not needed where there is only one beside the times.",
        examples=["force"],
    )
    input_unit: str = Field(
        default="N",
        description="Unit of the input in input_file: that of the displacements for a motion of the base, any other "
        "for a force.",
        examples=["mm"],
    )


class RecordingConfig(MarkersConfig, CameraConfig, IdentifyOptions, _FileOptions):
    """One recording: the mode that was excited, and options that differ from `[camera]` and `[markers]`."""

    @model_validator(mode="after")
    def _one_target(self) -> RecordingConfig:
        if self.mode is not None and self.target_frequency_hz is not None:
            msg = "give either mode or target_frequency_hz, not both"
            raise ValueError(msg)
        return self

    @model_serializer(mode="wrap")
    def _only_what_was_given(self, serialize: SerializerFunctionWrapHandler) -> dict[str, Any]:
        # A default written out would override [camera] and [markers] when it is read back.
        return {key: value for key, value in serialize(self).items() if key in self.given()}

    def given(self) -> dict[str, Any]:
        """Options that were given for this recording, without defaults."""
        return given_in(self)


class ExperimentConfig(Options):
    """The whole of `experiment.toml`; every section and key is optional."""

    camera: CameraConfig = CameraConfig()
    markers: MarkersConfig = MarkersConfig()
    beam: BeamConfig | None = None
    damping: DampingConfig = DampingConfig()
    air: AirConfig = AirConfig()
    updating: UpdatingConfig = UpdatingConfig()
    plan: PlanConfig = PlanConfig()
    recordings: tuple[RecordingConfig, ...] = ()

    @model_validator(mode="after")
    def _each_recording_once(self) -> ExperimentConfig:
        seen: set[str] = set()
        for recording in self.recordings:
            if recording.file in seen:
                msg = (
                    f"recordings: {recording.file!r} is listed twice; keep one [[recordings]] entry per file"
                )
                raise ValueError(msg)
            seen.add(recording.file)
        return self

    @model_validator(mode="after")
    def _markers_are_on_the_beam(self) -> ExperimentConfig:
        length_mm = None if self.beam is None else self.beam.length_mm
        if length_mm is None:
            return self
        for one in (self.markers, *self.recordings):
            problem = position_problem(one.positions_mm or (), length_mm)
            if problem is not None:
                raise ValueError(problem)
        return self

    def for_recording(self, file: str) -> RecordingConfig:
        """Options of one recording: its own entry takes precedence over `[camera]` and `[markers]`."""
        own = next((r for r in self.recordings if r.file == file), RecordingConfig(file=file))
        return RecordingConfig.model_validate({**dict(self.camera), **dict(self.markers), **own.given()})

    def with_camera(self, options: CameraConfig) -> ExperimentConfig:
        """A copy with what is given of the camera for every recording, in place of that in the file."""
        given = given_in(options)
        recordings = tuple(r.model_copy(update=given) for r in self.recordings)
        camera = self.camera.model_copy(update=given)
        return self.model_copy(update={"camera": camera, "recordings": recordings})

    def with_excitation(self, excitation: str, files: Sequence[str]) -> ExperimentConfig:
        """A copy in which these recordings have this excitation, in place of that in the file."""
        others = tuple(r for r in self.recordings if r.file not in files)
        given = {file: next((r.given() for r in self.recordings if r.file == file), {}) for file in files}
        own = tuple(
            RecordingConfig.model_validate({**given[file], "file": file, "excitation": excitation})
            for file in files
        )
        return self.model_copy(update={"recordings": (*others, *own)})
