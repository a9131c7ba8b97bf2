"""Stations whose small motion a predictive codec leaves out are not fitted; others are."""

from dataclasses import replace

import numpy as np
from kit.tracks import decoded, tracks_of

from modal_id.data import prepare
from tracker import displacement_series, flags
from tracker.line import codec_skipped

FPS, FREQUENCY_HZ, SD_PX, FRAMES = 1000.0, 31.0, 0.02, 1200
AMPLITUDES_PX = (0.03, 0.05, 0.5, 1.0)


def skipped(values, threshold):
    """What an encoder shows that repeats a block until it has moved by more than a threshold, which jitters."""
    rng = np.random.default_rng(5)
    shown, last = np.empty_like(values), values[0]
    for k, value in enumerate(values):
        if abs(value - last) > threshold * rng.uniform(0.5, 1.5):
            last = value
        shown[k] = last
    # Loop filters leave changes far below the noise.
    return shown + 1e-4 * rng.standard_normal(values.size)


def line(*, codec="h264", threshold_px=0.05, drift_px=0.0):
    """Stations of a prong with these amplitudes across a vertical line."""
    rng, t = np.random.default_rng(4), np.arange(FRAMES) / FPS
    wave = np.cos(2.0 * np.pi * FREQUENCY_HZ * t)
    wander = drift_px * np.cos(2.0 * np.pi * t / (t[-1] + 1e-3))
    x = [a * wave + wander + SD_PX * rng.standard_normal(FRAMES) for a in AMPLITUDES_PX]
    if threshold_px:
        x = [skipped(values, threshold_px) for values in x]
    count = len(AMPLITUDES_PX)
    return tracks_of(
        100.0 + np.stack(x, axis=1),
        20.0 * np.arange(count),
        fps=FPS,
        markers=tuple(f"s{k + 1}" for k in range(count)),
        sd_x_px=np.full((FRAMES, count), SD_PX),
        sd_y_px=np.full((FRAMES, count), 1e-4),
        decode=decoded(FRAMES, codec=codec, lossy=True, predictive=codec == "h264"),
        kind="line",
    )


def test_small_motion_that_the_codec_repeats_is_left_out_with_one_reason_for_all():
    tracks = line()
    assert [name for name, _ in codec_skipped(tracks)] == ["s1", "s2"], "below 4 sd rms, 0.08 px"
    drifts = line(drift_px=0.2)
    assert [name for name, _ in codec_skipped(drifts)] == ["s1", "s2"], (
        "one cycle in the record is no vibration"
    )
    prepared = prepare(displacement_series(tracks))
    assert prepared.channels.tolist() == [2, 3]
    (note,) = (note for note in prepared.notes if "left out" in note)
    assert note.startswith("Channels s1, s2 were left out: the codec repeats the pixels"), note


def test_small_motion_that_is_measured_in_every_frame_is_fitted():
    # White noise steps by less than 0.05 sd in 2.8 % of the frames: 34 +- 6 of 1200, against a limit of 180.
    assert codec_skipped(line(threshold_px=0.0)) == ()
    # Another codec does not predict frames, and another marker is chosen where the motion is large.
    assert codec_skipped(line(codec="mjpeg")) == ()
    assert displacement_series(line()).misleading
    assert not displacement_series(replace(line(), kind="patch")).misleading


def test_frames_repeated_as_a_whole_are_no_sign_of_it():
    tracks = line(threshold_px=0.0)
    twice = np.arange(FRAMES) // 2 * 2
    marks = tracks.flags.copy()
    marks[1::2] = flags.DUPLICATE_FRAME.value
    tracks = replace(tracks, x_px=tracks.x_px[twice], flags=marks)
    assert codec_skipped(tracks) == ()


def test_a_station_that_is_never_found_is_no_sign_of_it():
    tracks = line()
    lost = np.where(np.arange(len(AMPLITUDES_PX)) == 0, np.nan, tracks.x_px)
    assert [name for name, _ in codec_skipped(replace(tracks, x_px=lost))] == ["s2"]
