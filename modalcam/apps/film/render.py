"""Film the updated beam of a finished run with the camera of a recording: ``modalcam render OUT``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from modal_id import Identification
from modalcam.apps.film.beam import PLAYBACK_FPS
from modalcam.apps.film.footage import KeptFrames, NoFootage
from modalcam.apps.film.simulated import simulated_scene
from modalcam.commands import Options, opened
from modalcam.common import InputError, ModalcamError, shown
from modalcam.config import random_words
from modalcam.pipeline import (
    Progress,
    RecordingResult,
    generic_damping,
    measured_damping,
    measured_modes,
    replacing,
    update_beam,
)
from sim.render import Codec, render_frames, write_video
from tracker import MarkerTracks


def film_run(options: Options, name: str | None, path: Path, progress: Progress) -> int:
    """Film the simulated decay of one recording from the beginning of its fit to its end.

    The frames have the size, scale, exposure, gray levels, noise and times of the recording. Returns their number.
    ModalcamError if there is no such recording, or the beam cannot be simulated or filmed.
    """
    with opened(options, progress) as (context, _, measured):
        recordings = measured.recordings
        recording = chosen_recording(recordings, name, options.out)
        found, tracks, footage = recording.identification, recording.tracks, recording.added.get("frames")
        if not isinstance(found, Identification) or not isinstance(tracks, MarkerTracks):
            msg = f"{recording.name}: {recording.failure or 'it was not recorded with a camera'}"
            raise ModalcamError(msg)
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
        if isinstance(scene, NoFootage):
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


def chosen_recording(recordings: tuple[RecordingResult, ...], name: str | None, out: Path) -> RecordingResult:
    """The recording of this name or file, or the only one; InputError where there is none."""
    names = ", ".join(shown(r.name) for r in recordings)
    if name is None and len(recordings) == 1:
        return recordings[0]
    chosen = next((r for r in recordings if name in (r.name, r.file)), None)
    if chosen is None:
        what = "choose one with --recording" if name is None else f"there is no recording {shown(name)}"
        msg = f"{out}: {what}; it holds {names}"
        raise InputError(msg)
    return chosen
