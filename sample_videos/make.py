"""Recreate the sample recordings: `python sample_videos/make.py [FOLDER] [--check]`.

The paper's hanging beam is driven at each of its first five natural frequencies to steady state, stopped suddenly and
filmed while it decays. This script writes all files in this folder except README.md and itself. With --check it creates
the recordings in a temporary folder and compares them with the existing ones without changing them: byte for byte, but
for frames that a difference of 1e-8 in a frequency, such as between versions, rounds otherwise.

The amplitudes are typical of a real test: large rotation lowers the frequencies of modes 2 to 5 by about 0.01 %, more
than their standard deviation with accurate tracking. truth.json contains the values at small amplitude.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import tomli_w

from sim import MEASURED_DAMPING_RATIO, paper_beam, sample_beam
from sim.beam import AncfBeam, BeamProperties, beam_modes
from sim.damping import GenericDamping
from sim.render import (
    ArucoMarker,
    DotMarker,
    Marker,
    Optics,
    RecordingPlan,
    StagedRecording,
    stage_recording,
    write_video,
)

SEED = 20090
RESIDUAL_DAMPING_RATIO = 0.003
PLAYBACK_FPS = Fraction(30)
MODES_IN_STEADY_STATE = 8
QUALITY_SCALE = 2
DOT_POSITIONS_MM = (2.0, 90.0, 190.0, 290.0, 390.0, 490.0)
ARUCO_POSITIONS_MM = (15.0, 110.0, 205.0, 300.0, 395.0, 485.0)
ARUCO_DICTIONARY = "DICT_4X4_50"
DOT_MM, ARUCO_MM, QUIET_ZONE_MM = 12.0, 20.0, 3.0
EXPOSURE_S = 5.0e-4
# Twice what was seen between two versions: counts of a pixel, and share of the frames.
MOST_COUNTS, MOST_FRAMES = 8, 0.025
READ_NOISE_SD, NOISE_GAIN, LENS_BLUR_PX = 1.0, 0.04, 0.6


@dataclass(frozen=True, kw_only=True)
class Recording:
    """One sample recording; gray levels in 8-bit counts."""

    mode: int
    fps: int
    tip_amplitude_mm: float
    shake_s: float
    decay_s: float
    kind: str = "blob"
    mm_per_px: float = 1.0
    exposure_s: float = EXPOSURE_S
    foreground: float = 35.0
    background: float = 190.0

    @property
    def file(self) -> str:
        """File name of the recording."""
        return f"mode{self.mode}.avi"

    @property
    def positions_mm(self) -> tuple[float, ...]:
        """Distances of the markers from the clamp."""
        return ARUCO_POSITIONS_MM if self.kind == "aruco" else DOT_POSITIONS_MM

    @property
    def size_mm(self) -> float:
        """Diameter of a dot, side of an ArUco marker."""
        return ARUCO_MM if self.kind == "aruco" else DOT_MM

    def markers(self) -> tuple[Marker, ...]:
        """Markers on cards with the gray level of the background, which hide the beam around them."""
        if self.kind == "aruco":
            return tuple(
                ArucoMarker(
                    dictionary=ARUCO_DICTIONARY,
                    marker_id=i,
                    size_mm=ARUCO_MM,
                    quiet_zone_mm=QUIET_ZONE_MM,
                    foreground=self.foreground,
                    background=self.background,
                )
                for i in range(len(self.positions_mm))
            )
        dot = DotMarker(
            diameter_mm=DOT_MM,
            foreground=self.foreground,
            background=self.background,
            quiet_zone_mm=QUIET_ZONE_MM,
        )
        return (dot,) * len(self.positions_mm)


DARK = {"foreground": 220.0, "background": 45.0}
RECORDINGS = (
    Recording(mode=1, fps=100, tip_amplitude_mm=8.0, shake_s=2.0, decay_s=7.0),
    Recording(mode=2, fps=200, tip_amplitude_mm=3.0, shake_s=0.7, decay_s=4.0),
    Recording(mode=3, fps=250, tip_amplitude_mm=1.0, shake_s=0.5, decay_s=3.0, kind="aruco", mm_per_px=0.8),
    Recording(mode=4, fps=500, tip_amplitude_mm=0.6, shake_s=0.4, decay_s=2.2, **DARK),
    Recording(mode=5, fps=600, tip_amplitude_mm=0.4, shake_s=0.3, decay_s=1.7, **DARK),
)


def staged(recording: Recording) -> StagedRecording:
    """Simulate one recording.

    Raises
    ------
    ArithmeticError
        If the simulation does not converge.
    """
    found = stage_recording(
        sample_beam(),
        _damping(),
        RecordingPlan(
            mode_number=recording.mode,
            tip_amplitude_m=1e-3 * recording.tip_amplitude_mm,
            shake_s=recording.shake_s,
            decay_s=recording.decay_s,
        ),
        Optics(
            fps=Fraction(recording.fps),
            mm_per_px=recording.mm_per_px,
            exposure_s=recording.exposure_s,
            background=recording.background,
            lens_blur_px=LENS_BLUR_PX,
            read_noise_sd=READ_NOISE_SD,
            noise_gain=NOISE_GAIN,
        ),
        markers=recording.markers(),
        positions_m=1e-3 * np.array(recording.positions_mm),
        mode_count=MODES_IN_STEADY_STATE,
    )
    if not isinstance(found, StagedRecording):
        msg = f"{recording.file}: {found.reason}"
        raise ArithmeticError(msg)  # noqa: TRY004 - a result, not a type, is wrong
    return found


def make(folder: Path) -> list[str]:
    """Write all recordings, `experiment.toml` and `truth.json` into `folder`; returns the file names."""
    simulated = []
    for recording in RECORDINGS:
        simulated.append(staged(recording))
        frames = simulated[-1].frames(np.random.default_rng([SEED, recording.mode]))
        count = write_video(
            folder / recording.file, frames, fps_container=PLAYBACK_FPS, quality=QUALITY_SCALE
        )
        print(f"{recording.file}: {count} frames, {(folder / recording.file).stat().st_size / 1e6:.2f} MB")
    (folder / "experiment.toml").write_text(tomli_w.dumps(experiment()), encoding="utf-8")
    text = json.dumps(truth(simulated), indent=1, sort_keys=False) + "\n"
    (folder / "truth.json").write_text(text, encoding="utf-8")
    return [*(r.file for r in RECORDINGS), "experiment.toml", "truth.json"]


def experiment() -> dict[str, Any]:
    """Content of `experiment.toml`, with the nominal properties of the beam available to an experimenter."""
    beam = paper_beam()
    return {
        "camera": {"mm_per_px": 1.0, "exposure_s": EXPOSURE_S},
        "markers": {"kind": "blob", "size_mm": DOT_MM, "positions_mm": list(DOT_POSITIONS_MM)},
        "beam": {
            "length_mm": 1e3 * beam.length_m,
            "width_mm": 1e3 * float(beam.width_m[0]),
            "thickness_mm": 1e3 * float(beam.thickness_m[0]),
            "density_kg_m3": beam.density_kg_m3,
            "elastic_modulus_mpa": 1e-6 * beam.elastic_modulus_pa,
            "orientation": beam.orientation,
            "elements": beam.elements,
        },
        "recordings": [_entry(recording) for recording in RECORDINGS],
    }


def _entry(recording: Recording) -> dict[str, Any]:
    entry: dict[str, Any] = {"file": recording.file, "mode": recording.mode, "fps": float(recording.fps)}
    if recording.kind == "aruco":
        entry |= {
            "kind": "aruco",
            "dictionary": ARUCO_DICTIONARY,
            "size_mm": ARUCO_MM,
            "positions_mm": list(ARUCO_POSITIONS_MM),
            "mm_per_px": recording.mm_per_px,
        }
    return entry


def truth(simulated: list[StagedRecording]) -> dict[str, Any]:
    """Content of `truth.json`."""
    beam = sample_beam()
    modes = beam_modes(AncfBeam(beam), MODES_IN_STEADY_STATE)
    ratio = _damping().coefficients(modes).damping_ratio
    recordings = [
        {
            "file": recording.file,
            "mode": recording.mode,
            "frequency_hz": _digits(modes.frequency_hz[recording.mode - 1]),
            "damping_ratio": _digits(ratio[recording.mode - 1]),
            "onset_s": result.onset_s,
            "fps": recording.fps,
            "frames": result.frame_times_s.size,
            "mm_per_px": recording.mm_per_px,
            "exposure_s": recording.exposure_s,
            "tip_amplitude_mm": recording.tip_amplitude_mm,
            "centres_first_frame_px": np.round(result.centres_px[0], 4).tolist(),
        }
        for recording, result in zip(RECORDINGS, simulated, strict=True)
    ]
    return {
        "seed": SEED,
        "camera": {
            "lens_blur_px": LENS_BLUR_PX,
            "read_noise_sd": READ_NOISE_SD,
            "noise_gain": NOISE_GAIN,
            "bit_depth": 8,
        },
        "beam": _properties(beam),
        "frequency_hz": [_digits(f) for f in modes.frequency_hz],
        "damping_ratio": [_digits(z) for z in ratio],
        "recordings": recordings,
    }


def _damping() -> GenericDamping:
    return GenericDamping(MEASURED_DAMPING_RATIO, residual_ratio=RESIDUAL_DAMPING_RATIO)


def _properties(beam: BeamProperties) -> dict[str, Any]:
    return {
        "length_mm": 1e3 * beam.length_m,
        "width_mm": [_digits(1e3 * w) for w in beam.width_m],
        "thickness_mm": [_digits(1e3 * t) for t in beam.thickness_m],
        "density_kg_m3": beam.density_kg_m3,
        "elastic_modulus_mpa": 1e-6 * beam.elastic_modulus_pa,
        "orientation": beam.orientation,
        "point_masses": [
            {"position_mm": _digits(1e3 * p.position_m), "mass_g": _digits(1e3 * p.mass_kg)}
            for p in beam.point_masses
        ],
    }


def _digits(value: float) -> float:
    # Nine digits exceed any measurement accuracy and do not depend on the eigenvalue solver.
    return float(f"{value:.9g}")


def main(arguments: list[str]) -> int:
    """Create or check the samples; returns 0 on success."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=Path(__file__).resolve().parent)
    parser.add_argument("--check", action="store_true", help="compare with the folder instead of writing it")
    options = parser.parse_args(arguments)
    if not options.check:
        options.folder.mkdir(parents=True, exist_ok=True)
        make(options.folder)
        return 0
    with tempfile.TemporaryDirectory() as temporary:
        names = make(Path(temporary))
        different = [n for n in names if not _same(Path(temporary) / n, options.folder / n)]
    print(f"different: {', '.join(different)}" if different else "all files are the same")
    return 1 if different else 0


def _same(one: Path, other: Path) -> bool:
    if not other.is_file() or one.suffix != ".avi" or one.read_bytes() == other.read_bytes():
        return other.is_file() and one.read_bytes() == other.read_bytes()
    # A count that is rounded otherwise changes the block of its pixel by a few counts, in one frame of a hundred.
    changed = [np.abs(a - b).max() for a, b in zip(_frames(one), _frames(other), strict=True)]
    return max(changed) <= MOST_COUNTS and np.count_nonzero(changed) <= MOST_FRAMES * len(changed)


def _frames(path: Path) -> Iterator[Any]:
    with av.open(str(path)) as container:
        for frame in container.decode(video=0):
            yield frame.to_ndarray(format="gray8").astype(int)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
