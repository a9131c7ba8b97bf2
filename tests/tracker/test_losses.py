"""A track that is lost at the same phase of each cycle is left out with a reason; random and single losses are not."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from kit.tracks import decoded, tracks_of

from modal_id import identify
from modal_id.data import prepare
from tracker import displacement_series, flags, misleading_lost_markers

FPS, FREQUENCY_HZ, ZETA = 60.0, 0.9758, 8e-4


def pendulum(seen, n=600, other=0):
    """A ball on a pendulum, found where `seen(displacement, t)`; `other` marks frames that repeat or are damaged."""
    t = np.arange(n) / FPS
    swing = 150 * np.exp(-ZETA * 2 * np.pi * FREQUENCY_HZ * t) * np.cos(2 * np.pi * FREQUENCY_HZ * t)
    found = seen(swing, t)
    x = np.where(found, 320 + swing + 0.02 * np.random.default_rng(0).standard_normal(n), np.nan)[:, None]
    marks = np.where(found, 0, other or flags.NOT_FOUND.value).astype(np.uint32)[:, None]
    y, sd = np.where(np.isnan(x), np.nan, 120.0), np.where(np.isnan(x), np.nan, 0.02)
    return tracks_of(
        x, y, fps=FPS, sd_x_px=sd, sd_y_px=sd.copy(), flags=marks, decode=decoded(n, size=(640, 240))
    )


@pytest.mark.parametrize("above_px", [75.0, 120.0])
def test_a_ball_seen_near_one_turning_point_only_gives_no_mode(above_px):
    """Seen in a third or a fifth of each cycle, as where blur hides it; a fraction of the frequency fits as well."""
    tracks = pendulum(lambda swing, t: swing > above_px * np.exp(-ZETA * 2 * np.pi * FREQUENCY_HZ * t))
    ((name, reason),) = misleading_lost_markers(tracks)
    assert name == "m1"
    assert "same phase of its motion" in reason
    repeats = float(reason.split("repeat ")[1].split(" times")[0])
    assert repeats == pytest.approx(FREQUENCY_HZ, rel=0.02), "the losses have the frequency of the pendulum"
    result = identify(displacement_series(tracks))
    assert not result
    assert reason in result.reason


def test_a_pause_of_hours_takes_no_memory():
    tracks = pendulum(lambda swing, _: swing > 75.0)
    n = tracks.time_s.size
    paused = replace(tracks, time_s=tracks.time_s + np.where(np.arange(n) < n // 4, 0.0, 1e5))
    tracemalloc.start()
    ((name, _),) = misleading_lost_markers(paused)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert name == "m1", "the longer part is that of the test above"
    # The window of 1e5 s would take 8 bytes for each of four places a frame, 192 MB.
    assert peak < 5e6, f"{peak / 1e6:.1f} MB for {n} frames"


def test_a_channel_that_misleads_is_left_out_and_the_others_are_used():
    ball = pendulum(lambda swing, _: swing > 75.0)
    whole = pendulum(lambda swing, _: swing < np.inf)
    pair = {
        name: np.column_stack([getattr(ball, name), getattr(whole, name)])
        for name in ("x_px", "y_px", "sd_x_px", "sd_y_px", "flags")
    }
    both = replace(ball, markers=("m1", "m2"), positions_mm=np.full(2, np.nan), **pair)
    prepared = prepare(displacement_series(both))
    assert prepared.channels.tolist() == [1]
    assert "Channel m1 was left out" in prepared.notes[0]


def hidden_at_random(swing, t):
    return np.random.default_rng(1).random(t.size) < 0.4


@pytest.mark.parametrize(
    "seen",
    [
        hidden_at_random,
        lambda _, t: t < 3.0,
        lambda _, t: (t < 2.0) | (t > 7.0),
        lambda swing, _: swing < 100.0,
    ],
    ids=["at random", "the end", "the middle", "less than half of each cycle"],
)
def test_other_losses_leave_the_frequency_determined(seen):
    tracks = pendulum(seen)
    assert misleading_lost_markers(tracks) == ()
    mode = identify(displacement_series(tracks)).modes[0]
    # Gaps are left out of the fit, which stays right: within 4 of its stated sd.
    draws = mode.posterior.frequency_hz
    assert abs(float(draws.mean()) - FREQUENCY_HZ) < 4 * float(draws.std())


@pytest.mark.parametrize("flag", [flags.DUPLICATE_FRAME, flags.DECODE_CORRUPT, flags.OTHER_RATE])
def test_frames_in_which_nothing_can_be_measured_are_not_losses(flag):
    tracks = pendulum(lambda _, t: np.arange(t.size) % 2 == 0, other=flag.value)
    assert misleading_lost_markers(tracks) == (), f"{flag.name} in every second frame"
