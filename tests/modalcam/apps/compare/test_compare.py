"""`modalcam compare`: statistics against formulas of the textbook, files, page and refusals."""

import copy
import csv
import json
from functools import cache

import numpy as np
import pytest
from kit import runs
from scipy.stats import chi2, norm
from support.html_page import assert_sound

from modalcam.apps.compare import compare_runs, page
from modalcam.common import InputError
from modalcam.tables import summary

FREQUENCY_HZ, FREQUENCY_SD_HZ = 10.0, 0.002
DAMPING, DAMPING_SD = 0.003, 2e-5


@cache
def template():
    """Summary of a run of one recording of mode 1 and one whose mode has no number."""
    named = runs.recording(0, number=1, frequency_hz=FREQUENCY_HZ, damping_ratio=DAMPING)
    found = summary(runs.run_result([named, runs.recording(1, number=2, file="b.avi")]))
    tree = json.loads(json.dumps(found))
    tree["recordings"][1]["modes"][0]["mode"] = None
    return tree


def write_run(folder, frequencies_hz, dampings, *, clock_sd_hz=0.0, change=None):
    """A run whose recordings all excited mode 1, with these values."""
    tree = copy.deepcopy(template())
    first = tree["recordings"][0]
    tree["recordings"], tree["uncertainty"] = [], []
    for k, (frequency_hz, damping) in enumerate(zip(frequencies_hz, dampings, strict=True)):
        one = copy.deepcopy(first)
        one["recording"] = f"take_{k}"
        one["sha256"] = f"{folder.name} {k}"
        total = float(np.hypot(FREQUENCY_SD_HZ, clock_sd_hz))
        one["modes"][0] |= {
            "frequency_hz": frequency_hz,
            "frequency_sd_hz": total,
            "damping_ratio": damping,
            "damping_ratio_sd": DAMPING_SD,
            "frequency_small_amplitude_hz": frequency_hz + 1.0,
            "frequency_small_amplitude_sd_hz": 2.0 * total,
            "damping_ratio_small_amplitude": 2.0 * damping,
            "damping_ratio_small_amplitude_sd": 3.0 * DAMPING_SD,
        }
        tree["recordings"].append(one)
        tree["uncertainty"].append({"recording": one["recording"], "clock_hz": clock_sd_hz})
    if change is not None:
        change(tree)
    folder.mkdir(parents=True)
    (folder / "summary.json").write_text(json.dumps(tree))
    return folder


def dates(tmp_path, between_hz, count=8, seed=2):
    rng = np.random.default_rng(seed)
    values = FREQUENCY_HZ + rng.standard_normal(count) * np.hypot(FREQUENCY_SD_HZ, between_hz)
    return values, [write_run(tmp_path / f"day_{k}", [value], [DAMPING]) for k, value in enumerate(values)]


def test_differences_and_scatter_are_those_of_the_formulas(tmp_path):
    values, folders = dates(tmp_path, between_hz=0.006)
    (mode,) = compare_runs(folders).modes
    assert (mode.number, mode.name) == (1, "mode 1")
    found, sd = mode.frequency, np.sqrt(2.0) * FREQUENCY_SD_HZ
    assert np.isnan(found.runs[0].difference)
    for run, value in zip(found.runs[1:], values[1:], strict=True):
        assert run.difference == pytest.approx(value - values[0])
        assert run.interval == pytest.approx(norm.interval(0.9, value - values[0], sd))
        assert run.p_value == pytest.approx(2.0 * norm.sf(abs(value - values[0]) / sd))
    # With equal standard deviations DerSimonian-Laird, Paule-Mandel and REML are the same: the variance of the values
    # minus that stated.
    n = values.size
    assert found.combined.between_sd == pytest.approx(np.sqrt(np.var(values, ddof=1) - FREQUENCY_SD_HZ**2))
    assert found.combined.sd == pytest.approx(np.std(values, ddof=1) / np.sqrt(n))
    ends = (n - 1) * np.var(values, ddof=1) / chi2.ppf([0.95, 0.05], n - 1) - FREQUENCY_SD_HZ**2
    assert (found.between_low, found.between_high) == pytest.approx(tuple(np.sqrt(np.maximum(ends, 0.0))))
    assert found.combined.disagree
    assert not mode.damping.combined.disagree
    assert mode.damping.combined.between_sd == 0.0


def test_p_of_agreement_is_uniform_without_scatter_between_runs(tmp_path):
    found = [
        compare_runs(dates(tmp_path / str(seed), between_hz=0.0, count=3, seed=seed)[1]).modes[0].frequency
        for seed in range(60)
    ]
    p_values = np.sort([quantity.combined.p_value for quantity in found])
    # Kolmogorov-Smirnov distance of 60 values, exceeded once in a thousand.
    distance = np.max(np.abs(p_values - (np.arange(60) + 0.5) / 60))
    assert distance < 1.95 / np.sqrt(60)


def test_recordings_of_a_run_are_combined_with_their_own_scatter(tmp_path):
    several = write_run(tmp_path / "several", [10.0, 10.1, 9.9], [DAMPING] * 3)
    one = write_run(tmp_path / "one", [10.0], [DAMPING])
    first, second = compare_runs([several, one]).modes[0].frequency.runs
    assert first.recordings == ("take_0", "take_1", "take_2")
    # The scatter of 0.1 Hz far exceeds the stated 0.002: the error of the mean is that of the scatter.
    assert first.sd == pytest.approx(0.1 / np.sqrt(3), rel=1e-3)
    assert second.difference_sd == pytest.approx(np.hypot(first.sd, FREQUENCY_SD_HZ))


@pytest.mark.parametrize(("same_camera", "clock_hz"), [(False, 0.01), (True, 0.0)])
def test_the_error_of_one_clock_cancels_in_differences(tmp_path, same_camera, clock_hz):
    folders = [write_run(tmp_path / name, [10.0, 10.0], [DAMPING] * 2, clock_sd_hz=0.01) for name in "ab"]
    run = compare_runs(folders, same_camera=same_camera).modes[0].frequency.runs[1]
    # Two recordings halve the variance of the noise, not that of their common clock.
    assert run.sd == pytest.approx(np.sqrt(FREQUENCY_SD_HZ**2 / 2 + clock_hz**2))


def test_values_at_small_amplitude(tmp_path):
    folders = [write_run(tmp_path / name, [10.0], [DAMPING]) for name in "ab"]
    mode = compare_runs(folders, small_amplitude=True).modes[0]
    assert mode.frequency.runs[0].value == pytest.approx(11.0)
    assert mode.damping.runs[0].value == pytest.approx(2.0 * DAMPING)
    assert mode.damping.runs[0].sd == pytest.approx(3.0 * DAMPING_SD)


def test_a_mode_that_depends_on_different_amplitudes_is_noted(tmp_path):
    def larger(tree):
        tree["recordings"][0]["modes"][0] |= {"amplitude": 40.0, "flags": ["AMPLITUDE_DEPENDENT"]}

    folders = [write_run(tmp_path / "a", [10.0], [DAMPING])]
    folders += [write_run(tmp_path / "b", [10.0], [DAMPING], change=larger)]
    (note,) = compare_runs(folders).notes
    assert "b 40 mm" in note
    assert "--small-amplitude" in note
    assert compare_runs(folders, small_amplitude=True).notes == ()


def test_modes_without_a_number_are_matched_by_frequency(tmp_path):
    def unnumbered(tree):
        tree["recordings"][0]["modes"][0]["mode"] = None

    near = [write_run(tmp_path / f"near{k}", [10 + 0.1 * k], [DAMPING], change=unnumbered) for k in range(2)]
    assert compare_runs(near).modes[0].name == "10.05 Hz"
    numbered = write_run(tmp_path / "numbered", [10.2], [DAMPING])
    names = [run.run for run in compare_runs([*near, numbered]).modes[0].frequency.runs]
    assert names == ["near0", "near1", "numbered"]
    far = write_run(tmp_path / "far", [11.0], [DAMPING], change=unnumbered)
    assert compare_runs([*near, far]).notes == ("11 Hz was identified in far alone.",)
    with pytest.raises(InputError, match="no mode in common"):
        compare_runs([near[0], far])


def test_command_writes_what_it_prints(modalcam, tmp_path):
    _, folders = dates(tmp_path, between_hz=0.006, count=3)
    out = tmp_path / "comparison"
    code, text, _ = modalcam("compare", *folders, "-o", out)
    assert code == 0
    assert text.endswith(f"{out / 'compare.html'}\n")
    assert max(map(len, text.splitlines()[:-1])) <= 100
    tree = json.loads((out / "compare.json").read_text())
    with (out / "compare.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["run"] for row in rows] == ["day_0", "day_1", "day_2"] * 2
    html = assert_sound((out / "compare.html").read_text())
    for row, run in zip(rows[1:3], tree["modes"][0]["frequency"]["runs"][1:], strict=True):
        assert float(row["difference"]) == run["difference"]
        printed = f"{run['difference']:.4f}".replace("-", "−")
        assert printed in text
        assert printed in html.words
    code, _, error = modalcam("compare", *folders, "-o", out)
    assert code == 2
    assert "exists already" in error


def test_names_of_runs_stay_text(tmp_path):
    folders = [write_run(tmp_path / name.replace("/", "_"), [10.0], [DAMPING]) for name in runs.HOSTILE[:7]]
    html = page(compare_runs(folders))
    assert_sound(html)
    assert "<img" not in html
    assert "\u202e" not in html


@pytest.mark.parametrize(
    "damage",
    [
        lambda path: path.unlink(),
        lambda path: path.write_text("{"),
        lambda path: path.write_text("[]"),
        lambda path: path.write_text(json.dumps({"recordings": 3, "uncertainty": []})),
        lambda path: path.write_text(json.dumps({"recordings": [], "uncertainty": []})),
        lambda path: path.write_bytes(b"\xff\xfe"),
    ],
)
def test_folders_without_a_run_are_refused(modalcam, tmp_path, damage):
    folders = [write_run(tmp_path / name, [10.0], [DAMPING]) for name in "ab"]
    damage(folders[1] / "summary.json")
    code, _, error = modalcam("compare", *folders)
    assert code == 2
    assert str(folders[1]) in error
    assert "Traceback" not in error


def test_one_run_is_not_enough(modalcam, tmp_path):
    folder = write_run(tmp_path / "a", [10.0], [DAMPING])
    for arguments in ([folder], [folder, folder]):
        code, _, error = modalcam("compare", *arguments)
        assert code == 2
        assert "at least two runs" in error


def test_one_recording_is_counted_once(tmp_path):
    """Twice in one run, and in two runs: no standard deviation is divided by the root of two."""

    def same(tree):
        for recording in tree["recordings"]:
            recording["sha256"] = "one film"

    twice = write_run(tmp_path / "a", [10.0, 10.0], [0.003, 0.003], change=same)
    again = write_run(tmp_path / "b", [10.001], [0.003], change=same)
    other = write_run(tmp_path / "c", [10.002], [0.003])
    found = compare_runs([twice, again, other])
    (mode,) = found.modes
    assert mode.frequency.runs[0].sd == pytest.approx(FREQUENCY_SD_HZ, rel=1e-6)
    assert mode.frequency.runs[0].recordings == ("take_0",)
    assert mode.frequency.combined.sd >= FREQUENCY_SD_HZ / np.sqrt(2.0) * (1.0 - 1e-6), "two films, not four"
    assert sum("one measurement analysed more than once" in note for note in found.notes) == 1
