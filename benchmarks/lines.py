"""Stations of bare strips and edges against the truth: ``python -m benchmarks.lines [--peers] [--speed] [CASE ...]``.

Drawn films (`benchmarks.line_scenes`) are stored with each codec and tracked; the tables are in docs/studies/lines.md.
``--peers`` adds other tools at the same stations (`benchmarks.line_peers`), ``--speed`` measures the time instead
(`benchmarks.line_speed`).
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import numpy as np

from benchmarks.line_peers import PEERS, not_run, peer_errors
from benchmarks.line_scenes import CODECS, Array, LineScene, bound_px
from benchmarks.line_speed import speed
from sim.render import write_video
from tracker import MarkerTracks, TrackerSettings, track
from tracker.line import calibrate

FRAMES, FPS = 96, 1000.0
WIDE = {"shape": (360, 300)}
CASES: dict[str, LineScene] = {
    "strip of 4 px": LineScene(),
    "2 px": LineScene(width_px=2.0),
    "8 px": LineScene(width_px=8.0),
    "20 px": LineScene(width_px=20.0, shape=(360, 200)),
    "noise 1": LineScene(noise=1.0),
    "noise 8": LineScene(noise=8.0),
    "2 px, noise 8": LineScene(width_px=2.0, noise=8.0),
    "slanted by 30 degrees": LineScene(angle_rad=np.pi / 3.0, **WIDE),
    "along the pixels": LineScene(angle_rad=0.5 * np.pi),
    "curved at rest": LineScene(angle_rad=1.2, bend_rad=0.5, **WIDE),
    "tip to 0.37 of the length": LineScene(tip_px=(110.0, 0.0), clamp_px=(150.3, 30.6), **WIDE),
    "blur of 5 px": LineScene(tip_px=(10.0, 0.0), cycles_per_frame=(0.11, 0.2), exposure=0.7),
    "light falls by half": LineScene(light=0.5),
    "background texture, sd 2": LineScene(texture=2.0),
    "background texture, sd 6": LineScene(texture=6.0),
    "edge": LineScene(feature="edge"),
    "edge, slanted": LineScene(feature="edge", angle_rad=np.pi / 3.0, **WIDE),
}


def errors(scene: LineScene, tracks: MarkerTracks) -> dict[str, float]:
    """Figures of merit of the stations but the first and the last, against the truth and the bound."""
    arc = _arc_px(scene, tracks)
    x, y = tracks.x_px[:, 1:-1], tracks.y_px[:, 1:-1]
    across = np.full(x.shape, np.nan)
    for k in range(len(x)):
        points, normals = scene.points(float(k), arc)
        normals = normals / np.linalg.norm(normals, axis=1)[:, None]
        across[k] = (x[k] - points[:, 0]) * normals[:, 0] + (y[k] - points[:, 1]) * normals[:, 1]
    error = across - np.nanmean(across, axis=0)
    sd = np.hypot(tracks.sd_x_px, tracks.sd_y_px)[:, 1:-1]
    reach = calibrate.TUNING.edge_flank_px if scene.feature == "edge" else 0.5 * scene.width_px + 4.0
    times = range(0, FRAMES, 8) if scene.exposure else (0, FRAMES // 2)
    spacing = float(np.mean(np.diff(arc)))
    bound = float(np.sqrt(np.mean([bound_px(scene, k, arc, spacing, reach) ** 2 for k in times])))
    rms = float(np.sqrt(np.nanmean(error**2)))
    known = np.isfinite(error)
    wave = 2.0 * abs(np.mean(error[known] * np.exp(2j * np.pi * x[known])))
    return {
        "bound": bound,
        "rms": rms / bound,
        "sd": rms / float(np.sqrt(np.nanmean(sd**2))),
        "locking": float(wave) / bound,
        "found": float(np.mean(known)),
    }


def _arc_px(scene: LineScene, tracks: MarkerTracks) -> Array:
    """Distances of the stations but the first and the last from the clamp."""
    share = (tracks.positions_mm - tracks.positions_mm[0]) / np.ptp(tracks.positions_mm)
    first, last = (_nearest_px(scene, tracks.x_px[0, k], tracks.y_px[0, k]) for k in (0, -1))
    return np.asarray((first + share * (last - first))[1:-1])


def _nearest_px(scene: LineScene, x_px: float, y_px: float) -> float:
    """Distance from the clamp, along the line in the first frame, of the point nearest to one in the image."""
    s = np.arange(0.0, scene.length_px, 0.05)
    points = scene.points(0.0, s)[0]
    return float(s[np.argmin(np.hypot(points[:, 0] - x_px, points[:, 1] - y_px))])


def run_case(name: str, codec: str, folder: Path, peers: list[str]) -> Iterator[str]:
    """Rows of one film."""
    scene = CASES[name]
    encoder, suffix, options = CODECS[codec]
    path = folder / f"film.{suffix}"
    write_video(path, iter(scene.frames(FRAMES)), fps_container=Fraction(50), codec=encoder, **options)
    ends = scene.points(0.0, np.array([0.0, scene.length_px]))[0]
    settings = TrackerSettings(
        fps=FPS,
        kind="line",
        line_px=ends.round().tolist(),
        positions_mm=(0.0, scene.length_px),
        exposure_s=scene.exposure / FPS or None,
    )
    tracks = track(path, settings)
    if not isinstance(tracks, MarkerTracks):
        yield f"| {name} | {codec} | {tracks.reason} |"
        return
    found = errors(scene, tracks)
    yield f"| {name} | {codec} | {_cells(found)} |"
    for peer in peers:
        try:
            rms, known = peer_errors(PEERS[peer], scene, path, FRAMES, _arc_px(scene, tracks))
        except Exception as error:  # noqa: BLE001 - any failure of a tool is reported in its row
            yield f"| {name}: {peer} | {codec} | {not_run(error)} |"
            continue
        yield f"| {name}: {peer} | {codec} | | {rms / found['bound']:.2f} | | | {100.0 * known:.1f} |"


def main(arguments: list[str]) -> None:
    """Print the table, or the time."""
    parser = argparse.ArgumentParser(description="Accuracy of the stations of bare strips and edges.")
    parser.add_argument("cases", nargs="*", choices=[*CASES, []], help="cases to run; all without any")
    parser.add_argument("--peers", action="store_true", help="add other tools at the same stations")
    parser.add_argument("--speed", action="store_true", help="measure the time instead")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        if options.speed:
            sys.stdout.write(speed(Path(folder)) + "\n")
            return
        sys.stdout.write(
            "| scene | codec | bound / px | rms / bound | rms / stated sd | locking / bound | found / % |\n"
        )
        sys.stdout.write("| --- | --- | --- | --- | --- | --- | --- |\n")
        for name in options.cases or CASES:
            for codec in CODECS:
                for line in run_case(name, codec, Path(folder), list(PEERS) if options.peers else []):
                    sys.stdout.write(line + "\n")
                    sys.stdout.flush()


def _cells(found: dict[str, float]) -> str:
    return (
        f"{found['bound']:.4f} | {found['rms']:.2f} | {found['sd']:.2f} | {found['locking']:.2f} | "
        f"{100.0 * found['found']:.1f}"
    )


if __name__ == "__main__":
    main(sys.argv[1:])
