"""Options, files and folders that are made to harm: one line of refusal, nothing overwritten, nothing exhausted."""

import json
import os
import resource
import shutil
import sys
from contextlib import contextmanager

import numpy as np
import pytest
from kit import attacks
from kit.films import write_decay
from kit.series import pole_of
from scipy.io import savemat

from modalcam import cli
from modalcam.common import ExitCode


def write_table(path, frequency_hz=10.0, text="y"):
    time_s = np.arange(400) / 100.0
    values = np.exp(pole_of(frequency_hz, 0.01) * time_s).real
    values += 0.01 * np.random.default_rng(1).standard_normal(time_s.size)
    np.savetxt(path, np.column_stack([time_s, values]), "%.9g", ",", header=f"time_s,{text}", comments="")
    return path


@pytest.fixture
def identified(in_process, no_figures, shared_folder, tmp_path, modalcam):
    """A table and its results without figures, copied from the one run that all tests share."""

    def fill(folder):
        path = write_table(folder / "decay.csv")
        assert modalcam("identify", path, "-o", folder / "out")[0] == ExitCode.OK

    folder = tmp_path / "identified"
    shutil.copytree(shared_folder("identified table", fill), folder)
    return folder / "decay.csv", folder / "out"


@contextmanager
def full_medium(most_bytes):
    """Writing a file beyond this size fails as on a full medium; root, who may run the tests, has no other limit."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def content(folder):
    return {name: data for name, data in attacks.content(folder).items() if name.rpartition("/")[2] != "lock"}


def test_files_that_exist_are_replaced_with_force_only(modalcam, tmp_path):
    """Without it they are refused, as in test_refusals.py."""
    write_decay(tmp_path)
    mine = tmp_path / "experiment.toml"
    before = mine.read_bytes()
    assert modalcam("init", tmp_path, "-o", mine, "--force")[0] == ExitCode.OK
    assert mine.read_bytes() != before


def test_results_of_another_recording_are_not_replaced(modalcam, tmp_path, identified):
    _, out = identified
    before = content(out)
    other = write_table(tmp_path / "b.csv", 11.0)
    code, _, err = modalcam("identify", other, "-o", out)
    assert code == ExitCode.USAGE
    assert "holds the results of decay.csv, not of b.csv" in err
    folder = write_decay(tmp_path / "videos")
    assert "holds the results of decay.csv" in modalcam("run", folder, "-o", out)[2]
    assert content(out) == before
    assert modalcam("identify", other, "-o", out, "--force")[0] == ExitCode.OK
    assert "b," in (out / "modes.csv").read_text()


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3))])
def test_damaged_results_are_computed_again(modalcam, identified, seed):
    path, out = identified
    before = content(out)
    rng = np.random.default_rng(seed)
    for state in (out / "state").glob("*.npz"):
        data = bytearray(state.read_bytes())
        if seed == 0:
            del data[len(data) // 2 :]
        else:
            data[rng.integers(len(data))] ^= 1 << int(rng.integers(8))
        state.write_bytes(data)
    assert modalcam("identify", path, "-o", out)[0] == ExitCode.OK
    after = content(out)
    assert after["modes.csv"] == before["modes.csv"]


def test_a_log_that_is_no_text_is_written_again(modalcam, identified):
    _, out = identified
    assert modalcam("report", out)[0] == ExitCode.OK
    before = (out / "run.log").read_bytes()
    (out / "run.log").write_bytes(b"\xff\xfe")
    assert modalcam("report", out)[0] == ExitCode.OK
    assert (out / "run.log").read_bytes() == before


def test_a_record_cannot_lead_out_of_its_folder(modalcam, tmp_path, identified):
    _, out = identified
    record = out / "state" / "run.json"
    planted = json.loads(record.read_text())
    for name in ("../../victim/x", "/victim/x", "..\\..\\victim", "a/b"):
        planted["sources"][0]["name"] = name
        planted["results"][name] = planted["results"].get("decay", {})
        record.write_text(json.dumps(planted))
        before = content(tmp_path)
        code, _, err = modalcam("report", out)
        assert code == ExitCode.USAGE, name
        assert "expected the name of a recording" in err
        assert content(tmp_path) == before


def test_a_unit_is_no_formula_of_the_table(modalcam, tmp_path, in_process, no_figures):
    out = tmp_path / "out"
    path = write_table(tmp_path / "=cmd.csv", text="=1+1\x1b[2J")
    assert modalcam("identify", path, "-o", out, "--unit", '=HYPERLINK("x")')[0] == ExitCode.USAGE
    assert modalcam("identify", path, "-o", out)[0] == ExitCode.OK
    for table in out.rglob("*.csv"):
        cells = [cell for line in table.read_text().splitlines() for cell in line.split(",")]
        assert not [cell for cell in cells if cell.lstrip('"')[:1] in ("=", "@", "\t") or "\x1b" in cell]


def test_one_unreadable_place_is_one_line_and_does_not_stop_the_others(modalcam, tmp_path, in_process):
    folder = write_decay(tmp_path / "videos")
    (folder / "loop").symlink_to(folder / "loop")
    (folder / "loop.avi").symlink_to(folder / "loop.avi")
    assert modalcam("probe", folder)[0] == ExitCode.OK, "links are skipped without --follow-symlinks"
    code, _, _ = modalcam("probe", folder, "--follow-symlinks")
    assert code == ExitCode.PARTIAL
    code, _, err = modalcam("track", folder, "-o", tmp_path / "out", "--follow-symlinks")
    assert code == ExitCode.PARTIAL
    assert err.count("cannot be read (Too many levels of symbolic links)") == 2
    assert list((tmp_path / "out" / "tracks").glob("*.csv"))


@pytest.mark.parametrize("command", ["info", "probe"])
def test_a_closed_reader_of_output_ends_a_command_quietly(tmp_path, in_process, monkeypatch, capfd, command):
    write_decay(tmp_path)
    reader, writer = os.pipe()
    os.close(reader)
    monkeypatch.setattr(sys, "argv", ["modalcam", command, *([str(tmp_path)] if command == "probe" else [])])
    with os.fdopen(writer, "w") as closed:
        monkeypatch.setattr(sys, "stdout", closed)
        with pytest.raises(SystemExit) as end:
            cli.main()
    assert end.value.code == ExitCode.CLOSED_OUTPUT
    assert capfd.readouterr().err == ""


def test_tracking_prints_its_notes(modalcam, tmp_path, in_process):
    folder = write_decay(tmp_path / "videos")
    path = folder / "take.mkv"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    (folder / "other.avi").symlink_to(path)
    code, _, err = modalcam("track", folder, "-o", tmp_path / "out")
    assert code == ExitCode.OK
    assert "note: other.avi is a symbolic link and was skipped" in err
    assert "note: take: The file states a length of 4.666 s" in err


@pytest.mark.parametrize("most_bytes", [20_000, 300_000])
def test_a_medium_that_is_full_is_said_and_the_next_run_is_right(modalcam, tmp_path, identified, most_bytes):
    path, whole = identified
    out = tmp_path / "out"
    with full_medium(most_bytes):
        code, _, err = modalcam("identify", path, "-o", out)
    assert code == ExitCode.USAGE, err
    assert "cannot be written (File too large)" in err
    assert "Traceback" not in err
    assert modalcam("identify", path, "-o", out)[0] == ExitCode.OK
    assert (out / "modes.csv").read_bytes() == (whole / "modes.csv").read_bytes()


def test_a_matlab_file_that_ends_its_reader_by_a_signal_is_refused(modalcam, tmp_path):
    path = tmp_path / "a.mat"
    time_s = np.arange(300) / 100.0
    savemat(path, {"time_s": time_s, "y": np.cos(time_s)})
    data = bytearray(path.read_bytes())
    # A type of values that there is not.
    data[184:186] = b"\xff\xff"
    path.write_bytes(data)
    code, _, err = modalcam("identify", path, "-o", tmp_path / "out")
    assert code == ExitCode.USAGE
    assert "a.mat: " in err
    assert "Traceback" not in err
