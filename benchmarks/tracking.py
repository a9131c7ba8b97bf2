"""Accuracy relative to the Cramer-Rao bound and speed relative to decoding alone, compared with other tools.

``python -m benchmarks.tracking [--json] [--quick]``, from the repository's root.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.tracking_ours import (
    decode_and_track_fps,
    decode_only_fps,
    fps_from_memory,
    positions_and_sd,
    there_and_back,
    track_file,
)
from benchmarks.tracking_peers import PEERS
from benchmarks.tracking_scenes import FILES, FPS, KINDS, SCENES, Accuracy, Recording, accuracy, recording_of
from sim.render import write_video
from tracker import flags


@dataclass(frozen=True)
class Row:
    """A row of the table; `accuracy` is None if a tool could not be run, with the reason in `note`."""

    kind: str
    scene: str
    tool: str
    accuracy: Accuracy | None
    fps: float
    note: str = ""


@dataclass(frozen=True)
class Speed:
    """Frames per second for one file; `whole_fps` includes detection and calibration."""

    kind: str
    file: str
    decode_only_fps: float
    decode_and_track_fps: float
    whole_fps: float

    @property
    def over_decode(self) -> float:
        """Speed relative to decoding alone."""
        return self.decode_and_track_fps / self.decode_only_fps


def _ours(recording: Recording, kind: str, scene: str, bound: float, folder: Path) -> list[Row]:
    images, truth = recording.images(), recording.truth_px()
    rows = []
    files = FILES if scene == "still exposure" else {"lossless": FILES["lossless"]}
    for name, (codec, suffix, options) in files.items():
        path = folder / f"scene.{suffix}"
        write_video(path, images, fps_container=FPS / 20, codec=codec, **options)
        tracks = track_file(path, recording)
        xy, sd = positions_and_sd(tracks)
        poor = float(np.mean(tracks.flags & flags.POOR_FIT.value > 0))
        lossy = bool(np.all(tracks.flags & flags.LOSSY.value))
        note = f"{'LOSSY, ' if lossy else ''}{100 * poor:.1f} % POOR_FIT"
        rows.append(
            Row(kind, f"{scene}, {name}", "modalcam", accuracy(xy, truth, bound, sd), float("nan"), note)
        )
    return rows


def _peers(recording: Recording, kind: str, bound: float) -> list[Row]:
    frames, truth = np.stack(recording.images()), recording.truth_px()
    rows = []
    for name, peer, most in PEERS[kind]:
        some = frames[:most]
        try:
            peer(some[:2], truth[0])  # compiles
            start = time.perf_counter()
            xy = peer(some, truth[0])
        except Exception as error:  # noqa: BLE001 - any failure of a tool is reported in its row
            rows.append(Row(kind, "still exposure", name, None, float("nan"), f"not run: {error!r:.80}"))
            continue
        fps = len(some) / (time.perf_counter() - start)
        rows.append(Row(kind, "still exposure", name, accuracy(xy, truth[:most], bound), fps))
    return rows


def _speeds(recording: Recording, kind: str, frames: int, folder: Path) -> list[Speed]:
    images = there_and_back(recording.images(), frames)
    speeds = []
    for name, (codec, suffix, options) in FILES.items():
        if codec == "ffv1":
            continue
        path = folder / f"speed.{suffix}"
        write_video(path, images, fps_container=FPS / 20, codec=codec, **options)
        # Alternating runs, so that other load affects both; the fastest of each counts.
        pairs = [(decode_only_fps(path), decode_and_track_fps(path, recording)) for _ in range(3)]
        speeds.append(
            Speed(
                kind,
                name,
                max(p[0] for p in pairs),
                max(p[1][0] for p in pairs),
                max(p[1][1] for p in pairs),
            )
        )
    return speeds


def run(*, frames: int, speed_frames: int) -> dict[str, Any]:
    """Run all comparisons; returns a dictionary for JSON."""
    rows: list[Row] = []
    speeds: list[Speed] = []
    result: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for kind in KINDS:
            for scene in SCENES:
                recording = recording_of(kind, scene, frames)
                rows += _ours(recording, kind, scene, recording.bound_px(), folder)
            recording = recording_of(kind, "still exposure", frames)
            bound = recording.bound_px()
            fps, calibration_s = fps_from_memory(recording.images(), recording)
            rows += [
                Row(
                    kind,
                    "still exposure",
                    "modalcam from memory",
                    None,
                    fps,
                    f"calibrated in {calibration_s:.2f} s CPU",
                ),
                *_peers(recording, kind, bound),
            ]
            speeds += _speeds(recording, kind, speed_frames, folder)
            mine = next(r.accuracy for r in rows if r.kind == kind and r.accuracy is not None)
            of_kind = [s for s in speeds if s.kind == kind]
            result[kind] = {
                "bound_px": bound,
                "rms_over_bound": mine.rms_over_bound,
                "error_over_sd": mine.error_over_sd,
                "missing": mine.missing,
                "fps_from_memory": fps,
                "calibration_cpu_s": calibration_s,
                "speed_over_decode": of_kind[0].over_decode,
                "speed_over_decode_by_file": {s.file: s.over_decode for s in of_kind},
            }
    result["speed_over_decode"] = min(result[kind]["speed_over_decode"] for kind in KINDS)
    result["rows"] = [{**asdict(r), "accuracy": asdict(r.accuracy) if r.accuracy else None} for r in rows]
    result["speeds"] = [{**asdict(s), "over_decode": s.over_decode} for s in speeds]
    return result


def table(result: dict[str, Any]) -> str:
    """Format the result as text."""
    lines = [
        (
            f"{'':5} {'scene':28} {'tool':26} {'/bound':>7} {'err/sd':>7} {'slope':>9} {'locking':>8} "
            f"{'missing':>8} {'fps':>7}"
        )
    ]
    for row in result["rows"]:
        fps = "" if np.isnan(row["fps"]) else f"{row['fps']:.0f}"
        a = row["accuracy"]
        numbers = " " * 43
        if a is not None:
            sd = "" if np.isnan(a["error_over_sd"]) else f"{a['error_over_sd']:.3f}"
            numbers = (
                f"{a['rms_over_bound']:7.3f} {sd:>7} {a['amplitude_bias']:9.1e} {a['locking_px']:8.1e} "
                f"{100 * a['missing']:7.2f}%"
            )
        lines.append(f"{row['kind']:5} {row['scene']:28} {row['tool']:26} {numbers} {fps:>7}  {row['note']}")
    lines += [
        "",
        f"{'':5} {'file':20} {'decode only':>12} {'and track':>10} {'share':>6} {'whole run':>10}  (fps)",
    ]
    lines += [
        f"{s['kind']:5} {s['file']:20} {s['decode_only_fps']:12.0f} {s['decode_and_track_fps']:10.0f} "
        f"{100 * s['over_decode']:5.0f}% {s['whole_fps']:10.0f}"
        for s in result["speeds"]
    ]
    for kind in KINDS:
        lines.append(f"Cramer-Rao bound of {kind}: {result[kind]['bound_px']:.5f} px")
    return "\n".join(lines)


def main() -> None:
    """Run the benchmark and print the result."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.tracking", description=__doc__)
    parser.add_argument("--json", action="store_true", help="print JSON instead of the table")
    parser.add_argument("--quick", action="store_true", help="run a small version to check the installation")
    options = parser.parse_args()
    size = {"frames": 100, "speed_frames": 400} if options.quick else {"frames": 400, "speed_frames": 3000}
    result = run(**size)
    print(json.dumps(result, indent=1) if options.json else table(result))


if __name__ == "__main__":
    main()
