"""A commented `experiment.toml` with every option, and what the recordings of a folder tell."""

from __future__ import annotations

from pathlib import Path

from modalcam.inputs.probe import Probe, probe_folder
from modalcam.names import shown

_COMMON = """\
# Configuration of modalcam. Every key is optional; a line that begins with # is not in force.

[camera]
# Frames per second at which the scene was RECORDED. The rate in the file is usually that of playback.
#fps = 1000.0
# Scale in the plane of the beam; or give markers.size_mm.
#mm_per_px = 1.0
# Standard deviation of that scale, where it is known.
#sd_mm_per_px = 0.002
# Exposure time of a frame.
#exposure_s = 0.0005
# Rolling shutter: time from the exposure of the first row to that of the last.
#readout_s = 0.0
# Lens distortion: a file of `modalcam calibrate`, beside this one, as in
# lens = "camera.toml"

[markers]
# "aruco" (printed codes), "blob" (round dots), "patch" (points you give, no marker at all), "auto"
#kind = "auto"
# Any of OpenCV's dictionaries, or "auto".
#dictionary = "DICT_4X4_50"
# Side of an ArUco marker's black square, or diameter of a dot.
#size_mm = 12.0
# Distance of each marker from the clamp, in order along the beam; for ArUco in order of id.
#positions_mm = [2.0, 90.0, 190.0, 290.0, 390.0, 490.0]
# Oblique view: where the markers at rest lie in the plane of motion, x right and y up, four or more off one line.
# plane_mm = [[0.0, 0.0], [200.0, 0.0], [200.0, 150.0], [0.0, 150.0]]
# Side of the picture where the beam is clamped: "top", "bottom", "left", "right".
#clamp_side = "top"
# For "patch": centres in the first frame, and the side of the window that is followed.
#points_px = [[300.0, 120.0]]
#size_px = 31.0
# Names of markers that do not move: their motion is the camera's and is subtracted.
#reference = ["m1"]

# Without [beam] nothing is simulated.
#[beam]
#length_mm = 500.0
#width_mm = 5.0
#thickness_mm = 0.5
#density_kg_m3 = 8000.0
#elastic_modulus_mpa = 210000.0
# "hanging", "standing", "horizontal" (gravity across), "none"; "angled" with its angle from hanging, counter-clockwise
#orientation = "hanging"
# angle_deg = 30.0
#elements = 20
#[[beam.point_masses]]
#position_mm = 440.0
#mass_g = 0.4
#rotary_inertia_g_mm2 = 2.0
# A clamp that gives; without translation_n_m it only turns. Without this section it is rigid.
#[beam.clamp]
#rotation_n_m_rad = 300.0
#translation_n_m = 1e6

# Damping models that are compared with each recording; the others are scored against the first.
#[damping]
#models = ["generic", "rayleigh", "rayleigh_constant_k"]

# Air about the beam, whose drag grows with the square of the speed: a damping model of its own in the comparison.
#[air]
#density_kg_m3 = 1.204
# "identify" fits it where the damping ratio rises with the amplitude; a number is taken as it is; 0 leaves it out.
#drag_coefficient = "identify"

# What updating holds possible: relative change of widths, thicknesses, density and modulus (twice the prior's standard
# deviation); how far along the beam they hang together, in lengths of it; what the model cannot say of a frequency.
#[updating]
#bound = 0.1
#correlation_length = 0.1
#model_sd = 1e-4

# What `modalcam plan` assumes of an experiment that is not yet filmed; `run` does not read it. Lists have one number
# for all modes, or one for each.
#[plan]
#modes = [1, 2, 3, 4, 5]
#tip_amplitude_mm = [10.0, 2.5, 1.1, 0.6, 0.4]
#damping_ratio = [0.003]
#decay_s = 5.0
#read_noise_sd = 1.5
#noise_gain = 0.05
#lens_blur_px = 0.6
#bit_depth = 8
"""

_RECORDING_HINT = """
# One entry a recording. A recording may have its own fps, mm_per_px, sd_mm_per_px, exposure_s, readout_s, lens, kind,
# dictionary,
# size_mm, size_px, positions_mm, plane_mm, points_px, reference and clamp_side; mode (number of the mode that was
# excited) or target_frequency_hz; onset_s (start of the free decay; found when absent).
"""


def starter_config(folder: Path) -> str:
    """Text of a configuration for the recordings of `folder`.

    Raises
    ------
    InputError, NoInputError
        If the folder holds no recordings.
    """
    probes = probe_folder(folder, follow_symlinks=False)
    return _COMMON + _RECORDING_HINT + "".join(_entry(p) for p in probes)


def _entry(p: Probe) -> str:
    if p.problem:
        return f"\n# {shown(p.file)}: {_one_line(p.problem)}\n"
    if not p.file.isprintable():
        return f"\n# {shown(p.file)}: rename it to configure it, its name cannot be written here\n"
    rate = "unknown" if p.fps_container is None else f"{p.fps_container:g}"
    return (
        f"\n# {p.packets} frames of {p.size_px} px, {p.bit_depth} bit, {p.codec}; the file says {rate} fps\n"
        f"[[recordings]]\nfile = {_toml_string(p.file)}\n#mode = 1\n#fps = 1000.0\n"
    )


def _one_line(text: str) -> str:
    return shown(" ".join(text.split()))


def _toml_string(text: str) -> str:
    escaped = "".join("\\" + c if c in '"\\' else c for c in text)
    return f'"{escaped}"'
