"""CPU time of a line in footage of 640 x 480 px: decoding alone, calibration, following 100 stations, other tools."""

from __future__ import annotations

import time
from fractions import Fraction
from pathlib import Path

import numpy as np

from benchmarks.line_peers import PEERS, not_run
from benchmarks.line_scenes import Array, LineScene
from sim.render import write_video
from tracker import TUNING, TrackerSettings, track
from tracker.video import open_recording

SCENE = LineScene(
    length_px=430.0, clamp_px=(300.3, 20.6), shape=(480, 640), tip_px=(8.0, 2.0), texture=3.0, dark=60.0
)
DRAWN, LOOPS, STATIONS, FPS = 60, 12, 100, 1000.0


def speed(folder: Path) -> str:
    """Table of CPU time, of all threads together: it does not depend on what else the machine does.

    Decoding runs ahead in a thread of its own, so that with two free cores the longer of both decides.
    """
    drawn = SCENE.frames(DRAWN)
    path = folder / "speed.avi"
    # There and back: without jumps.
    images = (drawn + drawn[-2:0:-1]) * LOOPS
    write_video(path, iter(images), fps_container=Fraction(50), codec="mjpeg", quality=3)
    ends = SCENE.points(0.0, np.array([0.0, SCENE.length_px]))[0]
    settings = TrackerSettings(fps=FPS, kind="line", line_px=ends.round().tolist(), stations=STATIONS)
    # The first run compiles or loads the kernels.
    track(path, settings)
    alone = _decoding_s(path)
    calibration_s, whole_s, both = _tracking_s(path, settings)
    rows = [
        f"| decoding alone | {1e3 * alone:.2f} | {1.0 / alone:.0f} |",
        f"| decoding and tracking {STATIONS} stations | {1e3 * both:.2f} | {1.0 / both:.0f} |",
    ]
    arc = (np.arange(STATIONS) + 0.5) / STATIONS * SCENE.length_px
    points, normals = SCENE.points(0.0, arc)
    rows += [_peer_row(name, path, len(images), points, normals) for name in PEERS]
    return "\n".join(
        [
            "| MJPG, 640 x 480 px | CPU time of a frame / ms | frames per CPU second |",
            "| --- | --- | --- |",
            *rows,
            f"\nCalibration: {calibration_s:.1f} s; whole run of {len(images)} frames: {whole_s:.1f} s.",
        ]
    )


def _decoding_s(path: Path) -> float:
    start = time.process_time()
    count = sum(1 for _ in open_recording(path).frames())
    return (time.process_time() - start) / count


def _tracking_s(path: Path, settings: TrackerSettings) -> tuple[float, float, float]:
    """CPU seconds until the first frame is followed, of the whole run, and of a later frame."""
    stamps: list[float] = []
    start = time.process_time()
    track(path, settings, progress=lambda _done, _declared: stamps.append(time.process_time()))
    whole = time.process_time() - start
    # The calibration frames, and those decoded ahead during the calibration.
    first = 2 * TUNING.calibration_frames
    return stamps[0] - start, whole, (stamps[-1] - stamps[first]) / (len(stamps) - 1 - first)


def _peer_row(name: str, path: Path, frames: int, points: Array, normals: Array) -> str:
    try:
        PEERS[name](path, 2, points, normals)  # compiles
        start = time.process_time()
        PEERS[name](path, frames, points, normals)
    except Exception as error:  # noqa: BLE001 - any failure of a tool is reported in its row
        return f"| {name} | {not_run(error)} | |"
    each = (time.process_time() - start) / frames
    return f"| {name} | {1e3 * each:.2f} | {1.0 / each:.0f} |"
