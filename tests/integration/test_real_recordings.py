"""Third-party recordings on the command line: filmed tuning forks, an accelerometer on a cantilever."""

import csv
import json
import shutil

import numpy as np
import pytest
from support.paths import REALDATA as REAL
from support.paths import REALDATA_ABSENT

pytestmark = [
    pytest.mark.skipif(not REAL.is_dir(), reason=REALDATA_ABSENT),
    # test_commands.py has worker processes and figures
    pytest.mark.usefixtures("in_process", "no_figures"),
]


def target_of(out):
    with (out / "modes.csv").open(newline="") as file:
        return next(row for row in csv.DictReader(file) if row["target"] == "True")


@pytest.fixture(scope="module")
def fork_folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fork")
    (source,) = (REAL / "tuning_forks").glob("tuning_hz32_fps1000*.mp4")
    shutil.copy(source, folder)
    (folder / "experiment.toml").write_text(FORK_TOML.format(fps="fps = 1000"))
    return folder


# Centre of the round weight at the tip of the left prong.
FORK_TOML = """
[camera]
{fps}
[markers]
kind = "patch"
points_px = [[298.0, 102.0]]
"""


@pytest.mark.slow  # in the fast suite: the same of this prong, tracked without the command (test_fork_prongs)
def test_fork_at_its_recorded_rate(modalcam, fork_folder, tmp_path):
    """31.971 Hz by an independent fit; zeta is uncertain, as test_fork_prongs.py explains, and a fifth of it lost."""
    code, _, err = modalcam("run", fork_folder, "-o", tmp_path / "out")
    assert (code, "The motion may be driven" in err) == (4, True), err
    row = target_of(tmp_path / "out")
    assert abs(float(row["frequency_hz"]) - 31.97) < 0.03
    low, high = float(row["damping_ratio_q05"]), float(row["damping_ratio_q95"])
    assert low <= 3.95e-4 <= high
    # At small amplitude, which the clip does not show, the interval is that of the damping of other structures.
    small, sd = float(row["damping_ratio_small_amplitude"]), float(row["damping_ratio_small_amplitude_sd"])
    assert small - 1.645 * sd <= 3.0e-4 <= small + 1.645 * sd
    # An amplitude error of each GOP.
    assert high - low > 2 * 1.645 * 1e-5, f"{low} to {high} is narrower than this clip allows"


@pytest.mark.slow  # in the fast suite: the warning in the tracks (test_real_footage) and in a report (test_report_html)
def test_fork_without_its_recorded_rate_warns(modalcam, fork_folder, tmp_path):
    folder = tmp_path / "forks"
    shutil.copytree(fork_folder, folder)
    (folder / "experiment.toml").write_text(FORK_TOML.format(fps=""))
    code, _, err = modalcam("run", folder, "-o", tmp_path / "out")
    assert code == 4
    assert "50 fps is a playback rate" in err
    verdict = "The frequency is unknown: the recorded frame rate is missing."
    assert verdict in (tmp_path / "out" / "report.html").read_text()
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["recordings"][0]["tracking"]["time_axis"]["source"] == "container"


@pytest.mark.slow  # in the fast suite: tracks at such an alias (test_real_footage) and the flag (test_hard_records)
def test_a_fork_above_half_the_frame_rate_is_reported_at_its_alias(modalcam, tmp_path):
    """128 Hz at 250 fps appears at 122.0 Hz; the footage cannot distinguish the two."""
    folder = tmp_path / "fork"
    folder.mkdir()
    (source,) = (REAL / "tuning_forks").glob("tuning_hz128_fps250*.mp4")
    shutil.copy(source, folder)
    toml = FORK_TOML.format(fps="fps = 250").replace("[298.0, 102.0]", "[364.0, 103.0]")
    (folder / "experiment.toml").write_text(toml)
    code, _, err = modalcam("run", folder, "-o", tmp_path / "out")
    assert code == 0, err
    row = target_of(tmp_path / "out")
    assert float(row["frequency_hz"]) == pytest.approx(122.0, abs=0.15)
    assert "ALIASED_POSSIBLE" in row["flags"]


# Fast: the record without a signal; test_real_accelerometer identifies the others without the command line.
CANTILEVER = [
    pytest.param(path, id=path.stem[:30], marks=pytest.mark.slow if k else ())
    for k, path in enumerate(sorted((REAL / "al_cantilever").glob("*.npy")))
]


@pytest.mark.parametrize("path", CANTILEVER)
def test_cantilever(modalcam, path, tmp_path):
    time_s, acceleration_g = np.load(path)
    csv_path = tmp_path / "series.csv"
    np.savetxt(csv_path, np.c_[time_s, acceleration_g], "%.9g", ",", header="time_s,a", comments="")
    code, _, err = modalcam("identify", csv_path, "-o", tmp_path / "out", "--unit", "g")
    if not acceleration_g.any():
        assert code == 3
        assert "FAILED series.csv" in err
        return
    assert code == 0, err
    expected, tolerance = (16.33, 0.05) if path.name.startswith("30cm") else (6.05, 0.02)
    assert abs(float(target_of(tmp_path / "out")["frequency_hz"]) - expected) < tolerance
