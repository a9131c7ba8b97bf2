"""`experiment.toml`: what the user says about camera, markers, beam and recordings."""

from __future__ import annotations

import difflib
from fractions import Fraction
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PlainSerializer, model_validator

MAX_FPS = 10**9

MarkerKind = Literal["aruco", "blob", "patch", "auto"]
Orientation = Literal["hanging", "standing", "horizontal", "angled", "none"]
ClampSide = Literal["top", "bottom", "left", "right"]


def parse_fps(value: object) -> Fraction:
    """Frame rate as an exact fraction, from 1000, 59.94, "30000/1001" or a Fraction.

    Raises
    ------
    ValueError
        If it is no number, not positive, or above 1e9.
    """
    msg = f"expected frames per second, a positive number such as 1000, 59.94 or 30000/1001; found {value!r}"
    if isinstance(value, bool) or not isinstance(value, int | float | str | Fraction):
        raise ValueError(msg)  # noqa: TRY004 - pydantic turns ValueError into a message with the key's path
    try:
        # Fraction of the text: 59.94 is 5994/100, not the binary number next to it.
        fps = Fraction(str(value).strip())
    except (ValueError, ZeroDivisionError):
        raise ValueError(msg) from None
    if not 0 < fps <= MAX_FPS:
        raise ValueError(msg)
    return fps


def write_fps(fps: Fraction) -> float | str:
    """Frame rate for a TOML file: a number where that is exact, else a fraction in text."""
    return float(fps) if Fraction(str(float(fps))) == fps else str(fps)


Fps = Annotated[Fraction, BeforeValidator(parse_fps), PlainSerializer(write_fps, return_type=float | str)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
PointPx = tuple[Finite, Finite]


def _file_name(value: object) -> str:
    if not isinstance(value, str) or not value:
        msg = f"expected the name of a file, found {value!r}"
        raise ValueError(msg)
    return value


def _dictionary(value: object) -> str:
    # OpenCV is slow to load, and few configurations name a dictionary.
    import cv2  # noqa: PLC0415

    known = ["auto", *sorted(name for name in dir(cv2.aruco) if name.startswith("DICT_"))]
    if value not in known:
        close = difflib.get_close_matches(str(value), known, n=3)
        msg = (
            f"expected an ArUco dictionary of OpenCV such as {', '.join(close or known[:3])}; found {value!r}"
        )
        raise ValueError(msg)
    return str(value)


Dictionary = Annotated[str, BeforeValidator(_dictionary)]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class LensConfig(_Section):
    """A lens as `modalcam calibrate` writes it, with standard deviations for people to read."""

    width_px: Annotated[int, Field(gt=0)]
    height_px: Annotated[int, Field(gt=0)]
    focal_px: tuple[Positive, Positive]
    centre_px: PointPx
    distortion: tuple[Finite, Finite, Finite, Finite, Finite]
    rms_px: NonNegative | None = None
    focal_sd_px: tuple[NonNegative, NonNegative] | None = None
    centre_sd_px: tuple[NonNegative, NonNegative] | None = None
    distortion_sd: tuple[NonNegative, ...] | None = None
    pictures: int | None = None


class CameraConfig(_Section):
    """Camera: recorded rate, scale, exposure."""

    fps: Fps | None = None
    mm_per_px: Positive | None = None
    sd_mm_per_px: Positive | None = None
    exposure_s: NonNegative | None = None
    readout_s: Finite | None = None
    # A file beside experiment.toml; reading the configuration puts what it holds in its place.
    lens: LensConfig | str | None = None


class MarkersConfig(_Section):
    """Markers: what to look for and where it sits on the beam."""

    kind: MarkerKind = "auto"
    dictionary: Dictionary = "auto"
    size_mm: Positive | None = None
    size_px: Positive | None = None
    positions_mm: tuple[NonNegative, ...] | None = None
    plane_mm: tuple[PointPx, ...] | None = None
    points_px: tuple[PointPx, ...] | None = None
    reference: tuple[str, ...] = ()
    clamp_side: ClampSide | None = None


class PointMassConfig(_Section):
    """A mass fixed to the beam: a sensor, a marker."""

    position_mm: NonNegative
    mass_g: Positive
    rotary_inertia_g_mm2: NonNegative = 0.0


class ClampConfig(_Section):
    """A clamp that gives: moment per rotation, and force per displacement where it is not rigid against that."""

    rotation_n_m_rad: Positive
    translation_n_m: Positive | None = None


class BeamConfig(_Section):
    """Beam: geometry, material, how it is mounted."""

    length_mm: Positive | None = None
    width_mm: Positive | None = None
    thickness_mm: Positive | None = None
    density_kg_m3: Positive | None = None
    elastic_modulus_mpa: Positive | None = None
    orientation: Orientation = "hanging"
    angle_deg: Finite | None = None
    elements: Annotated[int, Field(ge=2, le=1000)] = 20
    point_masses: tuple[PointMassConfig, ...] = ()
    clamp: ClampConfig | None = None

    @model_validator(mode="after")
    def _angle_belongs_to_angled(self) -> BeamConfig:
        if (self.orientation == "angled") != (self.angle_deg is not None):
            msg = (
                'angle_deg (from hanging, counter-clockwise) goes with orientation = "angled", and that needs it; '
                f"found orientation = {self.orientation!r} and angle_deg = {self.angle_deg}"
            )
            raise ValueError(msg)
        return self

    def missing(self) -> tuple[str, ...]:
        """Keys that the simulation needs and that are not given."""
        needed = ("length_mm", "width_mm", "thickness_mm", "density_kg_m3", "elastic_modulus_mpa")
        return tuple(key for key in needed if getattr(self, key) is None)


class PlanConfig(_Section):
    """What `modalcam plan` assumes of an experiment that is not yet filmed; `run` does not read it.

    Noise and lens blur are in counts and pixels of the camera at its bit depth. Numbers per mode are one for all
    modes, or one for each of `modes`.
    """

    modes: Annotated[tuple[Annotated[int, Field(ge=1, le=20)], ...], Field(min_length=1)] = (1, 2, 3, 4, 5)
    tip_amplitude_mm: tuple[Positive, ...] | None = None
    damping_ratio: tuple[Annotated[float, Field(gt=0.0, lt=0.5)], ...] | None = None
    decay_s: Positive | None = None
    read_noise_sd: NonNegative = 1.5
    noise_gain: NonNegative = 0.05
    lens_blur_px: Annotated[float, Field(ge=0.1, le=10.0)] = 0.6
    bit_depth: Annotated[int, Field(ge=8, le=16)] = 8


class AirConfig(_Section):
    """Air about the beam, whose quadratic drag is a damping model of its own."""

    density_kg_m3: Positive = 1.204
    # A number is taken as it is; 0 leaves the drag out of the comparison.
    drag_coefficient: NonNegative | Literal["identify"] = "identify"


class UpdatingConfig(_Section):
    """What updating assumes of the beam before it is measured.

    Widths, thicknesses, density and modulus lie within `bound` of those of `[beam]` (a prior standard deviation of
    half of it), and vary along the beam over `correlation_length` lengths of it; `model_sd` is the relative standard
    deviation of what the model cannot say about a frequency.
    """

    bound: Annotated[float, Field(gt=0.0, le=0.5)] = 0.10
    correlation_length: Annotated[float, Field(ge=0.02, le=100.0)] = 0.1
    model_sd: Annotated[float, Field(ge=1e-6, le=0.1)] = 1e-4


class RecordingConfig(_Section):
    """One recording: its mode, and what differs from `[camera]` and `[markers]`."""

    # Any text: names on disk need not be valid UTF-8, which pydantic's own text must be.
    file: Annotated[Any, BeforeValidator(_file_name)]
    mode: Annotated[int, Field(ge=1, le=50)] | None = None
    target_frequency_hz: Positive | None = None
    onset_s: NonNegative | None = None
    fps: Fps | None = None
    mm_per_px: Positive | None = None
    sd_mm_per_px: Positive | None = None
    exposure_s: NonNegative | None = None
    readout_s: Finite | None = None
    lens: LensConfig | str | None = None
    kind: MarkerKind | None = None
    dictionary: Dictionary | None = None
    size_mm: Positive | None = None
    size_px: Positive | None = None
    positions_mm: tuple[NonNegative, ...] | None = None
    plane_mm: tuple[PointPx, ...] | None = None
    points_px: tuple[PointPx, ...] | None = None
    reference: tuple[str, ...] | None = None
    clamp_side: ClampSide | None = None

    @model_validator(mode="after")
    def _target_is_named_once(self) -> RecordingConfig:
        if self.mode is not None and self.target_frequency_hz is not None:
            msg = "give either mode or target_frequency_hz, not both"
            raise ValueError(msg)
        return self


class ExperimentConfig(_Section):
    """The whole of `experiment.toml`; everything in it is optional."""

    camera: CameraConfig = CameraConfig()
    markers: MarkersConfig = MarkersConfig()
    beam: BeamConfig | None = None
    air: AirConfig = AirConfig()
    plan: PlanConfig = PlanConfig()
    updating: UpdatingConfig = UpdatingConfig()
    recordings: tuple[RecordingConfig, ...] = ()

    @model_validator(mode="after")
    def _each_recording_once(self) -> ExperimentConfig:
        seen: set[str] = set()
        for recording in self.recordings:
            if recording.file in seen:
                msg = f"recordings: {recording.file!r} is listed twice; keep one [[recordings]] entry a file"
                raise ValueError(msg)
            seen.add(recording.file)
        return self

    def for_recording(self, file: str) -> RecordingConfig:
        """What holds for one recording: its own entry over `[camera]` and `[markers]`."""
        own = next((r for r in self.recordings if r.file == file), RecordingConfig(file=file))
        common: dict[str, Any] = {**dict(self.camera), **dict(self.markers)}
        given = {key: value for key, value in dict(own).items() if value is not None}
        return RecordingConfig.model_validate({**common, **given})

    def with_fps(self, fps: Fraction) -> ExperimentConfig:
        """The same with `fps` for every recording, whatever the file says: the command line stands above it."""
        recordings = tuple(r.model_copy(update={"fps": fps}) for r in self.recordings)
        camera = self.camera.model_copy(update={"fps": fps})
        return self.model_copy(update={"camera": camera, "recordings": recordings})
