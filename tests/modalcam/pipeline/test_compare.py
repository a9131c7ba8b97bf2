"""Saved comparisons are reused only for the same identification."""

import csv
from dataclasses import replace

import numpy as np
import pytest
from kit import runs as report_runs
from kit.beams import experiment
from support.paths import APPS

from modalcam.config import ExperimentConfig
from modalcam.pipeline import Context, Workspace, compare_recordings
from sim import paper_beam
from sim.beam import AncfBeam, beam_modes
from tracker import Failure

POSITIONS_MM = np.array([90.0, 190.0, 290.0, 390.0, 490.0])


def two_modes_table(path):
    """Modes 2 and 3 of the paper's beam with equal amplitudes and noise of 1e-3."""
    modes = beam_modes(AncfBeam(paper_beam()), 3)
    shapes = modes.transverse_at(POSITIONS_MM * 1e-3)
    time_s = np.arange(480) / 400.0
    rng = np.random.default_rng(3)
    motion = rng.normal(0.0, 1e-3, (time_s.size, 5))
    for number, zeta in [(2, 0.004), (3, 0.005)]:
        omega = modes.omega_rad_s[number - 1]
        wave = np.exp(-zeta * omega * time_s) * np.cos(omega * np.sqrt(1 - zeta**2) * time_s)
        motion += 0.3 * np.outer(wave, shapes[:, number - 1] / np.abs(shapes[:, number - 1]).max())
    table = np.column_stack([time_s, motion])
    np.savetxt(path, table, "%.9g", ",", header="time_s,a,b,c,d,e", comments="")


@pytest.mark.usefixtures("in_process", "no_figures")
def test_another_target_in_the_same_folder_is_compared_again(modalcam, tmp_path):
    two_modes_table(tmp_path / "two.csv")
    markers = "[markers]\npositions_mm = [90.0, 190.0, 290.0, 390.0, 490.0]\n"
    # more models would only take more time
    models = '[damping]\nmodels = ["generic"]\n'
    (tmp_path / "c.toml").write_text(experiment(markers, models, elements=6))
    for mode, zeta in [(2, 0.004), (3, 0.005)]:
        args = ("identify", tmp_path / "two.csv", "-o", tmp_path / "out", "-c", tmp_path / "c.toml")
        assert modalcam(*args, "--unit", "mm", "--mode", mode, "--onset-s", 0)[0] == 0
        with (tmp_path / "out" / "comparison.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
        assert {int(row["mode"]) for row in rows} == {mode}
        measured = float(rows[0]["damping_ratio_measured"])
        # 40 dB or more on five channels: the Cramer-Rao bound is far below one percent
        assert measured == pytest.approx(zeta, rel=0.01)
        assert float(rows[0]["damping_ratio_simulated"]) == pytest.approx(measured, rel=0.01)


@pytest.mark.skipif(not APPS, reason="modalcam/apps was deleted")
def test_no_film_is_kept_of_a_simulation_that_failed(monkeypatch, tmp_path):
    """A film is rendered beside the comparison, which may fail after it."""
    (recording,) = report_runs.paper_recordings(1)
    other = replace(recording, name="other")
    ends = {recording.name: report_runs.comparison(recording.identification), "other": Failure("no", "other")}

    keys = {"comparison": "key", "simulated": "key"}

    def both(context, recordings, *_):
        for one in recordings:
            context.results[one.name] = dict(keys)
        return [replace(r, comparison=ends[r.name], added={"simulated": Failure("")}) for r in recordings]

    monkeypatch.setattr("modalcam.pipeline.compare.each_together", both)
    context = Context(ExperimentConfig(), Workspace(tmp_path), None, None, seed=0, force=False)
    (kept, dropped), _ = compare_recordings(context, [recording, other], report_runs.beam_result(elements=6))
    assert "simulated" in kept.added
    assert "simulated" not in dropped.added
    assert context.results == {recording.name: keys, "other": {"comparison": "key"}}
