"""What a plan is made from: the beam, the camera, the markers and the motion that is meant."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from modalcam.config.resolve import beam_properties
from modalcam.config.schema import ExperimentConfig
from modalcam.errors import ConfigError
from modalcam.video.film_beam import printed_markers
from sim.beam.properties import BeamProperties
from sim.reference.paper_beam import MEASURED_DAMPING_RATIO
from sim.render.camera import Camera
from sim.render.markers import Print

# Amplitude of the tip that keeps the bending of every mode alike: 10 mm at mode 1.
_TIP_OF_MODE_1_MM = 10.0
# Where no length is given: until the amplitude is down to this share, but no longer than this.
_LAST_SHARE = 0.03
_LONGEST_S = 20.0
_PLACEHOLDER_PX = 16


@dataclass(frozen=True)
class PlannedMode:
    """One recording that is meant: a mode, its amplitude at the tip, its damping ratio and how long it is filmed."""

    number: int
    tip_amplitude_mm: float
    damping_ratio: float
    decay_s: float | None


@dataclass(frozen=True)
class PlanRequest:
    """Everything a prediction needs.

    Attributes
    ----------
    camera : Camera
        Its scale, lens, noise, depth and exposure; its frame does not matter.
    fps : float
    positions_mm : tuple of float
        Of the markers, along the beam from the clamp.
    prints : tuple of Print
    """

    beam: BeamProperties
    camera: Camera
    fps: float
    positions_mm: tuple[float, ...]
    prints: tuple[Print, ...]
    modes: tuple[PlannedMode, ...]


def plan_request(config: ExperimentConfig, source: Path) -> PlanRequest:
    """A request from a configuration.

    Raises
    ------
    ConfigError
        If it lacks what a prediction needs: `[beam]`, camera.fps, camera.mm_per_px, markers.positions_mm and
        markers.size_mm; or if numbers in `[plan]` do not go together.
    """
    beam = beam_properties(config.beam)
    if isinstance(beam, str):
        needed = "to plan, [beam] is needed, with length_mm, width_mm, thickness_mm and elastic_modulus_mpa"
        msg = f"{source}: {needed if config.beam is None else beam}"
        raise ConfigError(msg)
    recording = config.for_recording("plan")
    fps, mm_per_px = recording.fps, recording.mm_per_px
    if fps is None or mm_per_px is None:
        msg = f"{source}: to plan, camera.fps and camera.mm_per_px are needed"
        raise ConfigError(msg)
    if recording.kind == "auto":
        recording = recording.model_copy(update={"kind": "blob"})
    positions, prints = printed_markers(recording, source)
    beyond = [p for p in positions if p > 1e3 * beam.length_m + 1e-9]
    if beyond:
        msg = f"{source}: markers.positions_mm: expected 0 to {1e3 * beam.length_m:g} mm, found {beyond[0]:g}"
        raise ConfigError(msg)
    wanted = config.plan
    camera = Camera(
        width_px=_PLACEHOLDER_PX,
        height_px=_PLACEHOLDER_PX,
        mm_per_px=mm_per_px,
        origin_px=(0.0, 0.0),
        exposure_s=recording.exposure_s or 0.0,
        lens_blur_px=wanted.lens_blur_px,
        read_noise_sd=wanted.read_noise_sd,
        noise_gain=wanted.noise_gain,
        bit_depth=wanted.bit_depth,
        background=200.0 * 2.0 ** (wanted.bit_depth - 8),
    )
    amplitudes = _for_each_mode("tip_amplitude_mm", wanted.tip_amplitude_mm, wanted.modes, source)
    dampings = _for_each_mode("damping_ratio", wanted.damping_ratio, wanted.modes, source)
    modes = tuple(
        PlannedMode(
            number,
            _TIP_OF_MODE_1_MM / number**2 if amplitude is None else amplitude,
            _usual_damping(number) if damping is None else damping,
            wanted.decay_s,
        )
        for number, amplitude, damping in zip(wanted.modes, amplitudes, dampings, strict=True)
    )
    return PlanRequest(beam, camera, float(fps), positions, prints, modes)


def decay_length_s(mode: PlannedMode, frequency_hz: float) -> float:
    """How long a mode's decay is filmed."""
    if mode.decay_s is not None:
        return mode.decay_s
    rate = 2.0 * np.pi * frequency_hz * mode.damping_ratio
    return float(min(-np.log(_LAST_SHARE) / rate, _LONGEST_S))


def _usual_damping(number: int) -> float:
    return MEASURED_DAMPING_RATIO[min(number, len(MEASURED_DAMPING_RATIO)) - 1]


def _for_each_mode(
    key: str, values: tuple[float, ...] | None, modes: tuple[int, ...], source: Path
) -> tuple[float | None, ...]:
    if values is None:
        return (None,) * len(modes)
    if len(values) == 1:
        return values * len(modes)
    if len(values) != len(modes):
        msg = (
            f"{source}: plan.{key}: expected 1 number, or {len(modes)} as plan.modes has; found {len(values)}"
        )
        raise ConfigError(msg)
    return values
