"""Films of a simulated beam: for `modalcam demo`, and of a configuration or a finished run for `modalcam render`."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from modal_id import Identification
from modalcam.apps.film.footage import KeptFrames
from modalcam.apps.film.simulated import STRIP_SHARE, rendered_markers, simulated_scene
from modalcam.commands import Options, opened
from modalcam.common import ConfigError, InputError, ModalcamError, OutputError, shown
from modalcam.config import (
    CONFIG_NAME,
    REQUIRED_OF_BEAM,
    BeamConfig,
    ExperimentConfig,
    RecordingConfig,
    beam_properties,
    dump_config,
    load_config,
    random_words,
)
from modalcam.pipeline import (
    Progress,
    RecordingResult,
    generic_damping,
    measured_damping,
    measured_modes,
    replacing,
    update_beam,
    write_text,
)
from sim import MEASURED_DAMPING_RATIO, MEASURED_FREQUENCY_HZ, sample_beam
from sim.beam import BeamProperties
from sim.damping import GenericDamping
from sim.render import (
    BareStrip,
    Codec,
    Optics,
    RecordingPlan,
    StagedRecording,
    Stripe,
    Surface,
    Texture,
    render_frames,
    stage_recording,
    write_video,
)
from tracker import Failure, MarkerTracks

# High-speed cameras store this playback rate, whatever the recorded rate.
PLAYBACK_FPS = Fraction(30)
_MODES_SIMULATED = 8
# of a bare beam: grain of its texture, distance of the points of the truth
_GRAIN_PX, _TRUTH_STEP_PX = 3.0, 4.0
_DEMO = {
    "camera": {"mm_per_px": 1.0},
    "markers": {"kind": "blob", "size_mm": 12.0, "positions_mm": (2.0, 90.0, 190.0, 290.0, 390.0, 490.0)},
    # the paper's beam, which is the example of each key
    "beam": {key: (BeamConfig.model_fields[key].examples or [None])[0] for key in REQUIRED_OF_BEAM},
}


def film_demo(folder: Path, modes: tuple[int, ...], seed: int, progress: Progress) -> Path:
    """Film the paper's beam in some of its modes; write the recordings and their experiment.toml into `folder`.

    OutputError if the folder holds anything but such a film of the same modes.
    """
    recordings = []
    for mode in modes:
        frequency = MEASURED_FREQUENCY_HZ[mode - 1]
        fps = Fraction(max(100, 10 * round(0.7 * frequency)))
        exposure_s = min(5e-4, 0.1 / frequency)
        recordings.append(RecordingConfig(file=f"mode{mode}.avi", mode=mode, fps=fps, exposure_s=exposure_s))
    config = ExperimentConfig.model_validate({**_DEMO, "recordings": recordings})
    text = dump_config(config)
    path = folder / CONFIG_NAME
    if folder.exists() and any(folder.iterdir()):
        if not path.is_file() or path.read_bytes() != text.encode():
            msg = f"{folder}: holds other files than this demonstration's; give another folder"
            raise OutputError(msg)
    else:
        # First: after an interrupt it identifies the folder as that of this demonstration.
        write_text(path, text)
    progress.begin("filming", len(modes))
    for mode, recording in zip(modes, recordings, strict=True):
        frequency, ratio = MEASURED_FREQUENCY_HZ[mode - 1], MEASURED_DAMPING_RATIO[mode - 1]
        plan = RecordingPlan(
            mode_number=mode,
            tip_amplitude_m=10e-3 / mode**2,
            shake_s=max(0.3, 5.0 / frequency),
            # Most of the amplitude decays, in a time short enough to wait for.
            decay_s=min(1.5 / (2.0 * np.pi * frequency * ratio), 8.0),
        )
        damping, camera = GenericDamping(MEASURED_DAMPING_RATIO), config.for_recording(recording.file)
        _film(folder / recording.file, sample_beam(), damping, plan, camera, seed)
        progress.advance(recording.file)
    return folder


def film_config(
    config_path: Path,
    out: Path,
    plan: RecordingPlan,
    damping_ratio: float,
    seed: int,
    progress: Progress,
    *,
    bare: bool = False,
    truth: Path | None = None,
) -> None:
    """Film the beam of a configuration with its camera and markers, every mode with the same damping ratio.

    A `bare` beam has no markers, a surface with texture and reflection, and a background with texture. `truth` is a
    file for the true positions: `write_truth`.

    Camera and markers are those of the recording named as `out`, else of the first recording of this mode. ConfigError
    if the configuration lacks what rendering needs, ModalcamError if the simulation fails.
    """
    config = load_config(config_path)
    properties = beam_properties(config.beam)
    if isinstance(properties, str):
        msg = f"{config_path}: {properties}"
        raise ConfigError(msg)
    same = [r.file for r in config.recordings if r.file == out.name or r.mode == plan.mode_number]
    recording = config.for_recording(out.name if out.name in same or not same else same[0])
    damping = GenericDamping((damping_ratio,) * plan.mode_number)
    progress.begin("filming", 1)
    try:
        film = _film(out, properties, damping, plan, recording, seed, bare=bare)
    except ConfigError as error:
        msg = f"{config_path}: {error}"
        raise ConfigError(msg) from error
    if truth is not None:
        write_truth(truth, film, recording)
    progress.advance(out.name)


def film_run(options: Options, name: str | None, path: Path, progress: Progress) -> int:
    """Film the simulated decay of one recording from the beginning of its fit to its end.

    The frames have the size, scale, exposure, gray levels, noise and times of the recording. Returns their number.
    ModalcamError if there is no such recording, or the beam cannot be simulated or filmed.
    """
    with opened(options, progress) as (context, _, measured):
        recordings = measured.recordings
        recording, found, tracks = chosen_recording(recordings, name, options.out)
        footage = recording.added.get("frames")
        if not isinstance(footage, KeptFrames):
            reason = "no frames of it were kept" if footage is None else footage.reason
            msg = f"{recording.name}: {reason}; run again with `modalcam run`"
            raise ModalcamError(msg)
        beam, notes, _ = update_beam(context, recordings, measured.theory)
        if beam is None or beam.updated is None:
            raise ModalcamError(" ".join(notes) or "the beam was not updated")
        damping = measured_damping(measured_modes(recordings), beam.standard_modes)
        rows = np.flatnonzero(found.decay_rows)
        config = context.config.for_recording(recording.file)
        # The exposure of a frame at the very onset would begin before the simulation.
        begins_s = tracks.time_s[rows] - 0.5 * (config.exposure_s or 0.0)
        rows = rows[begins_s >= found.onset.fit_from_s]
        scene = simulated_scene(
            footage,
            tracks,
            found,
            config,
            beam.updated.properties,
            generic_damping(beam.updated.properties, damping),
            highest_mode=max(damping.numbers),
            time_s=tracks.time_s[rows],
        )
        if isinstance(scene, Failure):
            msg = f"{recording.name}: {scene.reason}"
            raise ModalcamError(msg)
        width, height = tracks.decode.width_px, tracks.decode.height_px
        camera = replace(scene.camera, width_px=width, height_px=height, origin_px=(0.0, 0.0))
        rng = np.random.default_rng((options.seed, *random_words(recording.sha256)))
        frames = render_frames(scene.scene, camera, tracks.time_s[rows], rng)
        progress.begin("filming", 1)
        with replacing(path) as temporary:
            # Motion JPEG needs even sides: its colour planes have half the size.
            codec: Codec = "ffv1" if width % 2 or height % 2 else "mjpeg"
            count = write_video(temporary, frames, fps_container=PLAYBACK_FPS, codec=codec)
        progress.advance(path.name)
    return count


def chosen_recording(
    recordings: tuple[RecordingResult, ...], name: str | None, out: Path
) -> tuple[RecordingResult, Identification, MarkerTracks]:
    """The recording of this name or file, or the only one; ModalcamError where there is none, or it gave no mode."""
    chosen = next((r for r in recordings if name in (r.name, r.file)), None)
    if name is None and len(recordings) == 1:
        chosen = recordings[0]
    if chosen is None:
        what = "choose one with --recording" if name is None else f"there is no recording {shown(name)}"
        msg = f"{out}: {what}; it holds {', '.join(shown(r.name) for r in recordings)}"
        raise InputError(msg)
    found, tracks = chosen.identification, chosen.tracks
    if not isinstance(found, Identification) or not isinstance(tracks, MarkerTracks):
        msg = f"{chosen.name}: {chosen.failure or 'it was not recorded with a camera'}"
        raise ModalcamError(msg)
    return chosen, found, tracks


def write_truth(path: Path, film: StagedRecording, recording: RecordingConfig) -> None:
    """Write the true position of each point of a film into a compressed NumPy file (.npz).

    Arrays ``time_s``, (n,), from the first frame, ``position_mm``, (k,), along the beam from the clamp, ``x_px`` and
    ``y_px``, (n, k), at the middle of each exposure, and ``onset_s``. The points are the centres of the markers, or of
    a bare beam points at distances of 4 px along its centreline, with the tip.
    """
    strip = film.scene.strip
    if isinstance(strip, BareStrip):
        step_mm = _TRUTH_STEP_PX * film.camera.mm_per_px
        length_mm = float(strip.arc_mm[-1])
        positions_mm = np.append(np.arange(0.0, length_mm - 0.5 * step_mm, step_mm), length_mm)
        at = film.line_px(1e-3 * positions_mm)
    else:
        positions_mm, at = np.array(recording.positions_mm), film.centres_px
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(
            file,
            allow_pickle=False,
            time_s=film.frame_times_s - film.frame_times_s[0],
            position_mm=positions_mm,
            x_px=at[..., 0],
            y_px=at[..., 1],
            onset_s=film.onset_s,
        )


def _film(
    path: Path,
    properties: BeamProperties,
    damping: GenericDamping,
    plan: RecordingPlan,
    recording: RecordingConfig,
    seed: int,
    *,
    bare: bool = False,
) -> StagedRecording:
    fps, mm_per_px, positions_mm = recording.fps, recording.mm_per_px, recording.positions_mm
    if fps is None or mm_per_px is None or not (bare or positions_mm):
        what = (
            "camera.fps and camera.mm_per_px"
            if bare
            else "camera.fps, camera.mm_per_px and markers.positions_mm"
        )
        msg = f"to film the beam, {what} are needed"
        raise ConfigError(msg)
    optics = Optics(fps=fps, mm_per_px=mm_per_px, exposure_s=recording.exposure_s or 0.0)
    modes = max(_MODES_SIMULATED, len(damping.damping_ratio) + 1)
    look = _bare_beam(properties, optics, seed) if bare else _marked_beam(recording)
    try:
        film = stage_recording(
            properties, damping, plan, optics, mode_count=min(modes, 2 * properties.elements), **look
        )
    except ValueError as error:
        raise ModalcamError(str(error)) from error
    if not isinstance(film, StagedRecording):
        msg = f"the simulation stopped at {film.time_s:.6g} s (step {film.step}): {film.reason}"
        raise ModalcamError(msg)
    with replacing(path) as temporary:
        frames = film.frames(np.random.default_rng((seed, plan.mode_number)))
        write_video(temporary, frames, fps_container=PLAYBACK_FPS)
    return film


def _marked_beam(recording: RecordingConfig) -> dict[str, Any]:
    """Markers and their positions, for `stage_recording`; ConfigError where they cannot be rendered."""
    markers = rendered_markers(recording)
    if isinstance(markers, Failure):
        raise ConfigError(markers.reason)
    return {"markers": markers, "positions_m": 1e-3 * np.array(recording.positions_mm)}


def _bare_beam(properties: BeamProperties, optics: Optics, seed: int) -> dict[str, Any]:
    """Surface and background of a beam without markers, for `stage_recording`."""
    width_mm = 1e3 * float(properties.thickness_m.max())
    grain_mm = _GRAIN_PX * optics.mm_per_px
    surface = Surface(
        gray=STRIP_SHARE * optics.background,
        stripe=Stripe(gray=0.2 * optics.background, width_mm=0.12 * width_mm, offset_mm=0.15 * width_mm),
        texture=Texture(sd=0.03 * optics.background, grain_mm=grain_mm, seed=seed),
    )
    return {
        "surface": surface,
        "backdrop": Texture(sd=0.05 * optics.background, grain_mm=2.0 * grain_mm, seed=seed + 1),
    }
