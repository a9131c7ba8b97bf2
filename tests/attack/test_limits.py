"""Files that announce more than they hold, quantities that cannot be, interrupts and closed streams: one line each."""

import os
import subprocess
import sys
from struct import pack

import cv2
import numpy as np
import pytest
import tifffile
from kit.beams import BEAM

from modalcam.common import ConfigError, ExitCode, InputError
from modalcam.config import parse_config
from modalcam.inputs import Table, read_table, series_from_table, tracks_from_table
from tracker import TRACK_COLUMNS
from tracker.video import TiffSource, UnreadableVideoError, is_stack, read_photron_header


def test_images_that_a_tiff_announces_but_does_not_hold_are_not_counted(tmp_path):
    path = tmp_path / "announced.tif"
    page = np.zeros((48, 64), np.uint8)
    text = "ImageJ=1.53\nimages=10000000\nslices=10000000\n"
    tifffile.imwrite(path, page, description=text, photometric="minisblack", metadata=None)
    assert is_stack(path)
    source = TiffSource(path)
    assert source.info.frames_declared == 10_000_000
    assert source.stamps() == [0]
    assert len(list(source.frames())) == 1
    source.close()


def test_a_tiff_of_volumes_is_refused(tmp_path):
    path = tmp_path / "volumes.tif"
    with tifffile.TiffWriter(path) as file:
        for _ in range(2):
            file.write(np.zeros((16, 32, 32), np.uint8), volumetric=True, tile=(16, 32, 32), metadata=None)
    with pytest.raises(UnreadableVideoError, match="volumes of 16 images"):
        TiffSource(path)


@pytest.mark.parametrize("text", ["<a>" * 30_000 + "</a>" * 30_000, "<a " + "b='' " * 30_000 + "/>"])
def test_a_header_of_many_tags_is_refused_before_it_is_parsed(tmp_path, text):
    path = tmp_path / "nested.cihx"
    path.write_text(f"<?xml version='1.0'?><cih>{text}</cih>")
    with pytest.raises(UnreadableVideoError, match="tags and attributes"):
        read_photron_header(path)


@pytest.mark.parametrize(
    ("beam", "words"),
    [
        ({"length_mm": 0.5}, "length_mm is in metres, write 500"),
        ({"length_mm": 450.0}, "a marker at 490 mm from the clamp lies beyond the end of the beam"),
        ({"length_mm": 5.0}, "length_mm is in metres, write 5000"),
        ({"thickness_mm": 500.0}, "thickness_mm is in micrometres, write 0.5"),
        ({"thickness_mm": 0.0005}, "thickness_mm is in metres, write 0.5"),
        ({"width_mm": 0.005}, "width_mm is in metres, write 5"),
        ({"density_kg_m3": 8.0}, "in g/cm3, write 8000"),
        ({"density_kg_m3": 8e6}, "in g/m3, write 8000"),
        ({"elastic_modulus_mpa": 210.0}, "in GPa, write 210000"),
        ({"elastic_modulus_mpa": 2.1e11}, "in Pa, write 210000"),
    ],
)
def test_a_quantity_in_another_unit_is_named(beam, words):
    markers = {"positions_mm": [2.0, 90.0, 490.0]}
    parse_config({"beam": BEAM, "markers": markers}, where="e.toml")
    with pytest.raises(ConfigError, match=words):
        parse_config({"beam": BEAM | beam, "markers": markers}, where="e.toml")


@pytest.mark.parametrize("size_px", [501.0, 40_000, 1e308, float("inf"), float("nan"), 0.0])
def test_the_window_of_a_patch_has_a_largest_size(size_px):
    markers = {"kind": "patch", "points_px": [[20.0, 20.0]], "size_px": size_px}
    with pytest.raises(ConfigError, match=r"markers\.size_px: .*(at most|less than or equal|greater|finite)"):
        parse_config({"markers": markers}, where="experiment.toml")


def tracks_table(path, rows=20, **wrong):
    """A tracks file whose sixth row holds some wrong cells."""
    names = [column.name for column in TRACK_COLUMNS]
    lines = [",".join(names)]
    for k in range(rows):
        cells = {"frame": k, "time_s": k / 100, "marker": "a", "x_px": 5.0, "y_px": 50.0 + k % 3, "flags": ""}
        cells |= {"sd_x_px": 0.01, "sd_y_px": 0.01} | (wrong if k == 5 else {})
        lines.append(",".join(str(cells.get(name, "")) for name in names))
    path.write_text("\n".join(lines) + "\n")
    return read_table(path)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"rows": 0}, "at least 8 frames, found none"),
        ({"frame": "x"}, "column frame is not numeric"),
        ({"frame": "inf"}, "column frame: expected the numbers of frames"),
        ({"flags": "5"}, "column flags: unknown flag"),
        ({"y_px": "1e200"}, "between 1e-100 and 1e\\+100"),
    ],
)
def test_wrong_cells_of_a_tracks_file_are_named(tmp_path, wrong, words):
    table = tracks_table(tmp_path / "tracks.csv", **wrong)
    with pytest.raises(InputError, match=words):
        tracks_from_table(table, name="tracks", positions_mm=None, reference=())


@pytest.mark.parametrize("factor", [1e200, 1e-200])
def test_values_without_squares_are_refused(tmp_path, factor):
    time_s = np.arange(100) / 100.0
    path = tmp_path / "y.csv"
    values = np.column_stack([time_s, factor * np.cos(time_s)])
    np.savetxt(path, values, "%.9g", ",", header="time_s,y", comments="")
    table = read_table(path)
    assert isinstance(table, Table)
    with pytest.raises(InputError, match="change the unit"):
        series_from_table(table, name="y", unit="1")


@pytest.mark.parametrize("handler", ["default_int_handler", "SIG_IGN"])
def test_an_interrupt_of_the_start_ends_in_one_line(handler):
    """Unless it is ignored from the start, as a shell does for a command that a script runs in the background."""
    # Interrupts itself at the moment at which the command line is imported. The handler is set, since that of the tests
    # depends on how they were started.
    program = (
        "import os, runpy, signal, sys\n"
        f"signal.signal(signal.SIGINT, signal.{handler})\n"
        "class Interrupt:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'modalcam.cli':\n"
        "            os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Interrupt())\n"
        "sys.argv = ['modalcam', 'info']\n"
        "runpy.run_module('modalcam', run_name='__main__')\n"
    )
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    if handler == "SIG_IGN":
        assert (ended.returncode, ended.stderr) == (0, "")
        assert "modalcam" in ended.stdout
        return
    assert ended.returncode == ExitCode.INTERRUPTED
    assert ended.stderr == "modalcam: interrupted; run the same command again to continue\n"


@pytest.mark.skipif(os.name != "posix", reason="a shell closes the streams")
@pytest.mark.parametrize("stream", [1, 2])
def test_a_closed_stream_changes_no_exit_code(tmp_path, stream):
    command = [sys.executable, "-m", "modalcam", "check-config", tmp_path / "absent.toml"]
    given = {"preexec_fn": lambda: os.close(stream), "capture_output": True, "text": True}
    ended = subprocess.run(command, **given, check=False)
    assert ended.returncode == ExitCode.USAGE
    assert "Traceback" not in ended.stdout + ended.stderr


def test_the_log_of_a_library_does_not_reach_the_terminal(modalcam, tmp_path):
    path = tmp_path / "page.tif"
    tifffile.imwrite(path, np.zeros((32, 32), np.uint8), photometric="minisblack")
    cv2.imwrite(str(tmp_path / "other.png"), np.zeros((32, 32), np.uint8))
    data = bytearray(path.read_bytes())
    # The tag of the strips' offsets counts more than there are: tifffile logs an error.
    with tifffile.TiffFile(path) as file:
        offset = file.pages.first.tags["StripOffsets"].offset
    data[offset + 4 : offset + 8] = pack("<I", 3)
    path.write_bytes(data)
    code, _, err = modalcam("probe", tmp_path)
    assert code == ExitCode.NO_INPUT
    assert err.startswith("modalcam: ")
    assert "TiffPage" not in err
