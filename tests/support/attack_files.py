"""Intact files of every kind that modalcam reads, small and from one seed: what attacks start from."""

import warnings
from functools import cache

import numpy as np
import pyuff
from support import camera_files, tracker_media
from support.decay_clip import FPS, HEIGHT, WIDTH, swing_px
from support.modal_decays import pole_of

FRAMES = 24
QUICK = '[camera]\nfps = 100\nexposure_s = 1e-4\n[markers]\nkind = "blob"\n'
CONFIGURATION = """
[camera]
fps = 100.0
mm_per_px = 1.0
exposure_s = 1e-3
[markers]
kind = "blob"
size_mm = 12.0
positions_mm = [490.0]
[beam]
length_mm = 500.0
width_mm = 5.0
thickness_mm = 0.5
density_kg_m3 = 8000.0
elastic_modulus_mpa = 210000.0
elements = 6
point_masses = [{ position_mm = 440.0, mass_g = 0.4 }]
[plan]
modes = [1, 2]
[[recordings]]
file = "take.avi"
mode = 2
onset_s = 0.25
"""


@cache
def images():
    """A dot that oscillates and decays, with seeded noise."""
    rng = np.random.default_rng(1)
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    distances = [np.hypot(x - 32 - swing, y - 16) for swing in swing_px(np.arange(FRAMES) / FPS)]
    films = [200.0 - 170.0 * np.clip(6.5 - r, 0.0, 1.0) + rng.normal(0.0, 1.5, x.shape) for r in distances]
    return [np.clip(np.rint(image), 0, 255).astype(np.uint8) for image in films]


def decay():
    """Times and displacement of a decay."""
    time_s = np.arange(300) / 100.0
    noise = 0.01 * np.random.default_rng(1).standard_normal(time_s.size)
    return time_s, np.exp(pole_of(10.2, 0.01) * time_s).real + noise


def write_csv(path):
    np.savetxt(path, np.column_stack(decay()), "%.6g", ",", header="time_s,y", comments="")


def write_uff(path, binary=0):
    time_s, values = decay()
    data = pyuff.prepare_58(
        binary=binary,
        func_type=1,
        rsp_node=1,
        rsp_dir=3,
        ref_node=0,
        ref_dir=0,
        abscissa_spec_data_type=17,
        ordinate_spec_data_type=8,
        ordinate_axis_units_lab="mm",
        abscissa_spacing=1,
        orddenom_spec_data_type=0,
        z_axis_spec_data_type=0,
        x=time_s,
        data=values,
    )
    with warnings.catch_warnings():
        # pyuff opens a binary file a second time and does not close it.
        warnings.simplefilter("ignore", ResourceWarning)
        pyuff.UFF(str(path)).write_sets([data], "add")


def write_lvm(path):
    time_s, values = decay()
    head = "LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\nDecimal_Separator\t.\nX_Columns\tOne\n"
    second = "***End_of_Header***\t\n\nChannels\t1\nX_Dimension\tTime\nX0\t0.0\nDelta_X\t0.01\n"
    rows = "".join(f"{t:.6g}\t{y:.6g}\n" for t, y in zip(time_s, values, strict=True))
    path.write_text(f"{head}{second}***End_of_Header***\t\t\nX_Value\ty\tComment\n{rows}")


WRITERS = {
    "avi": lambda d: tracker_media.write(d / "take.avi", images()),
    "mp4": lambda d: tracker_media.write(d / "take.mp4", images(), codec="libx264"),
    "mkv": lambda d: tracker_media.write(d / "take.mkv", images(), codec="ffv1"),
    "mov": lambda d: tracker_media.write(d / "take.mov", images(), codec="mpeg4"),
    "gif": lambda d: camera_files.write_gif(d / "take.gif", images()),
    "tiff": lambda d: camera_files.write_stack(d / "take.tif", images()),
    "cih": lambda d: camera_files.write_photron(d / "take.cih", images(), bits=8),
    "cihx": lambda d: camera_files.write_photron(d / "take.cihx", images(), bits=8),
    "cine": lambda d: camera_files.write_cine(d / "take.cine", images(), bits=8),
    "toml": lambda d: (d / "experiment.toml").write_text(CONFIGURATION),
    "csv": lambda d: write_csv(d / "take.csv"),
    "uff": lambda d: write_uff(d / "take.uff"),
    "binary uff": lambda d: write_uff(d / "take.uff", binary=1),
    "lvm": lambda d: write_lvm(d / "take.lvm"),
    "npy": lambda d: np.save(d / "take.npy", np.column_stack(decay())),
    "state": lambda d: write_csv(d / "take.csv"),
}
TEXTS = ("toml", "csv", "uff", "lvm", "cih")
IDENTIFIED = ("csv", "uff", "binary uff", "lvm", "npy")
