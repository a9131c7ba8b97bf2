"""Footage of a simulated beam for `modalcam demo` and `modalcam render`."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np

from modalcam.config.resolve import beam_properties
from modalcam.config.schema import BeamConfig, ExperimentConfig, RecordingConfig
from modalcam.config.toml import CONFIG_NAME, dump_config, load_config
from modalcam.errors import ConfigError, ModalcamError
from modalcam.execution.progress import Progress
from modalcam.storage.atomic import replacing, write_text
from modalcam.video.printed_markers import printed_markers
from sim.beam.properties import BeamProperties
from sim.damping import GenericDamping
from sim.dynamics.trajectory import FailedSimulation
from sim.reference.paper_beam import MEASURED_DAMPING_RATIO, MEASURED_FREQUENCY_HZ, sample_beam
from sim.render.markers import DotMarker, Marker
from sim.render.recording import Film, Optics, RecordingPlan, film_recording
from sim.render.video import write_video

# What players are told: high-speed cameras write this rate whatever they recorded at.
PLAYBACK_FPS = Fraction(30)
_MODES_FILMED = 8


@dataclass(frozen=True)
class Shot:
    """A take of one mode, every mode damped by the same ratio."""

    mode: int
    tip_amplitude_m: float
    damping_ratio: float
    shake_s: float
    decay_s: float


def film_demo(folder: Path, modes: tuple[int, ...], seed: int, progress: Progress) -> Path:
    """Film the paper's beam at `modes` and write the footage with its experiment.toml into `folder`."""
    positions_mm = (2.0, 90.0, 190.0, 290.0, 390.0, 490.0)
    progress.begin("filming", len(modes))
    recordings = []
    for mode in modes:
        frequency = MEASURED_FREQUENCY_HZ[mode - 1]
        fps = Fraction(max(100, 10 * round(0.7 * frequency)))
        optics = Optics(fps=fps, mm_per_px=1.0, exposure_s=min(5e-4, 0.1 / frequency))
        # Long enough to lose most of the amplitude, short enough to wait for.
        decay_s = min(1.5 / (2.0 * np.pi * frequency * MEASURED_DAMPING_RATIO[mode - 1]), 8.0)
        take = RecordingPlan(
            mode_number=mode,
            tip_amplitude_m=10e-3 / mode**2,
            shake_s=max(0.3, 5.0 / frequency),
            decay_s=decay_s,
        )
        name = f"mode{mode}.avi"
        damping = GenericDamping(MEASURED_DAMPING_RATIO)
        prints = tuple(DotMarker(diameter_mm=12.0) for _ in positions_mm)
        _film(folder / name, sample_beam(), damping, take, optics, prints, positions_mm, (seed, mode))
        recordings.append(RecordingConfig(file=name, mode=mode, fps=fps, exposure_s=optics.exposure_s))
        progress.advance(name)
    config = ExperimentConfig.model_validate(
        {
            "camera": {"mm_per_px": 1.0},
            "markers": {"kind": "blob", "size_mm": 12.0, "positions_mm": positions_mm},
            "beam": {
                "length_mm": 500.0,
                "width_mm": 5.0,
                "thickness_mm": 0.5,
                "density_kg_m3": 8000.0,
                "elastic_modulus_mpa": 210000.0,
            },
            "recordings": recordings,
        }
    )
    write_text(folder / CONFIG_NAME, dump_config(config))
    return folder


def film_config(config_path: Path, out: Path, shot: Shot, seed: int, progress: Progress) -> None:
    """Film the beam of a configuration with its camera and markers.

    Raises
    ------
    ConfigError
        If the configuration lacks what a camera needs, or names a kind of marker that is not printed.
    ModalcamError
        If the simulation fails.
    """
    config = load_config(config_path)
    properties = _beam(config.beam, config_path)
    # The camera of the recording of this name, else of the first one made for this mode.
    same = [r.file for r in config.recordings if r.file == out.name or r.mode == shot.mode]
    recording = config.for_recording(out.name if out.name in same or not same else same[0])
    needed = {
        "camera.fps": recording.fps,
        "camera.mm_per_px": recording.mm_per_px,
        "markers.positions_mm": recording.positions_mm,
        "markers.size_mm": recording.size_mm,
    }
    if missing := [key for key, value in needed.items() if not value]:
        msg = f"{config_path}: to film the beam, give {', '.join(missing)}"
        raise ConfigError(msg)
    assert recording.fps is not None  # noqa: S101 - nothing is missing
    assert recording.mm_per_px is not None  # noqa: S101
    assert recording.positions_mm is not None  # noqa: S101
    positions = recording.positions_mm
    prints = printed_markers(
        recording.kind or "auto",
        [f"id{k}" for k in range(len(positions))],
        size_mm=recording.size_mm,
        dictionary=recording.dictionary,
        any_dictionary=True,
    )
    if isinstance(prints, str):
        msg = f"{config_path}: {prints}"
        raise ConfigError(msg)
    optics = Optics(fps=recording.fps, mm_per_px=recording.mm_per_px, exposure_s=recording.exposure_s or 0.0)
    damping = GenericDamping((shot.damping_ratio,) * shot.mode)
    take = RecordingPlan(
        mode_number=shot.mode,
        tip_amplitude_m=shot.tip_amplitude_m,
        shake_s=shot.shake_s,
        decay_s=shot.decay_s,
    )
    progress.begin("filming", 1)
    _film(out, properties, damping, take, optics, prints, positions, (seed, shot.mode))
    progress.advance(out.name)


def _film(
    path: Path,
    properties: BeamProperties,
    damping: GenericDamping,
    take: RecordingPlan,
    optics: Optics,
    prints: tuple[Marker, ...],
    positions_mm: tuple[float, ...],
    seed: tuple[int, int],
) -> None:
    modes = max(_MODES_FILMED, len(damping.damping_ratio) + 1)
    try:
        film = film_recording(
            properties,
            damping,
            take,
            optics,
            markers=prints,
            positions_m=1e-3 * np.array(positions_mm),
            rng=np.random.default_rng(seed),
            mode_count=min(modes, 2 * properties.elements),
        )
    except ValueError as error:
        raise ModalcamError(str(error)) from error
    if not isinstance(film, Film):
        raise ModalcamError(_failure(film))
    with replacing(path) as beside:
        write_video(beside, film.frames, fps_container=PLAYBACK_FPS)


def _failure(failed: FailedSimulation) -> str:
    return f"the simulation stopped at {failed.time_s:.6g} s (step {failed.step}): {failed.reason}"


def _beam(beam: BeamConfig | None, config_path: Path) -> BeamProperties:
    properties = beam_properties(beam)
    if isinstance(properties, str):
        msg = f"{config_path}: {properties}"
        raise ConfigError(msg)
    return properties
