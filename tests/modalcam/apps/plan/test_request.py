"""A plan from a configuration: settings per mode, and messages about missing keys."""

import doctest
import importlib
import re

import pytest
from kit.beams import BEAM
from support.paths import ROOT, SAMPLES

import modalcam
from modalcam.apps.plan import plan, plan_request, predict
from modalcam.common import ConfigError
from modalcam.config import ExperimentConfig, load_config

MARKERS = {"kind": "blob", "size_mm": 12.0, "positions_mm": [100.0, 300.0]}


def request(**sections):
    return plan_request(ExperimentConfig.model_validate({"beam": BEAM, **sections}), "experiment.toml")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"camera": {"fps": None}}, "to plan mode 2, give camera.fps"),
        ({"plan": {"tip_amplitude_mm": [1.0, 2.0, 3.0]}}, "found 3"),
        ({"markers": {"kind": "patch"}}, "found 'patch'"),
        ({"markers": {"positions_mm": None}}, "markers.positions_mm"),
    ],
)
def test_missing_and_mismatched_keys_are_named(changes, words, plan_of):
    with pytest.raises(ConfigError, match=words):
        plan_of(**changes)


def test_every_missing_key_of_the_beam_and_of_a_recording_is_named_at_once():
    keys = r"beam\.length_mm, .*beam\.density_kg_m3, beam\.elastic_modulus_mpa"
    with pytest.raises(ConfigError, match=keys):
        plan_request(ExperimentConfig(), "experiment.toml")
    with pytest.raises(ConfigError, match=r"camera\.fps .*camera\.mm_per_px .*markers\.positions_mm"):
        request()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"camera": {"fps": 1e-9}}, "at least 12 frames in the decay"),
        ({"camera": {"mm_per_px": 1e6}}, "px of the smallest marker"),
        ({"camera": {"mm_per_px": 1e-6}}, "px of the largest marker"),
        ({"camera": {"exposure_s": 1e300}}, "px of motion blur"),
        ({"plan": {"tip_amplitude_mm": [1e300]}}, "px of motion"),
        ({"plan": {"decay_s": 1e300}}, "cycles in the decay"),
        ({"markers": {"positions_mm": [1e-300]}}, "not determined by frames"),
    ],
)
def test_numbers_that_no_experiment_has_are_refused(changes, words, plan_of):
    with pytest.raises(ValueError, match=words):
        predict(plan_of(**changes))


def test_the_readme_example_can_be_planned(tmp_path):
    path = tmp_path / "experiment.toml"
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    path.write_text(re.search(r"```toml\n(.*?)```", text, re.DOTALL)[1], encoding="utf-8")
    found = plan(path)
    config = load_config(path)
    assert [m.number for m in found.modes] == [1, 2, 3, 4, 5]
    assert {m.planned.fps for m in found.modes} == {float(config.camera.fps)}
    assert found.to_dataframe().shape[0] == 5
    table = found.to_dataframe()
    assert list(table.index) == [1, 2, 3, 4, 5]
    assert table.attrs["units"].items() >= {"frequency_sd_hz": "Hz", "decay_s": "s"}.items()
    assert "mode 5" in repr(found)
    assert "\n" not in repr(found)
    assert "<table" in found._repr_html_()
    # A key missing in every recording is listed among the assumptions.
    if config.markers.size_mm is None:
        assert any("markers.size_mm is not given" in text for text in found.request.assumptions)


def test_the_sample_recordings_are_planned_with_their_rates_scales_and_markers():
    modes = plan_request(load_config(SAMPLES / "experiment.toml"), "experiment.toml").modes
    assert [(m.number, m.fps, m.camera.mm_per_px) for m in modes] == [
        (1, 100.0, 1.0),
        (2, 200.0, 1.0),
        (3, 250.0, 0.8),
        (4, 500.0, 1.0),
        (5, 600.0, 1.0),
    ]
    kinds = [type(m.markers[0]).__name__ for m in modes]
    assert kinds == ["DotMarker"] * 2 + ["ArucoMarker"] + ["DotMarker"] * 2
    assert modes[2].positions_mm[0] == 15.0
    assert {m.camera.exposure_s for m in modes} == {5e-4}


def test_settings_common_to_all_recordings_apply_to_the_other_modes():
    recordings = [{"file": f"{n}.avi", "mode": n, "fps": 250, "mm_per_px": 0.5 * n} for n in (1, 2)]
    with pytest.raises(ConfigError, match=r"to plan mode 3, give camera\.mm_per_px .* differ in mm_per_px"):
        request(markers=MARKERS, recordings=recordings, plan={"modes": [1, 3]})
    for recording in recordings:
        recording["mm_per_px"] = 0.5
    found = request(markers=MARKERS, recordings=recordings)
    assert {(m.fps, m.camera.mm_per_px) for m in found.modes} == {(250.0, 0.5)}
    assert len(found.modes) == 5


def test_without_planned_modes_only_those_with_known_settings_are_planned():
    recordings = [{"file": f"{n}.avi", "mode": n, "fps": 100 * n, "mm_per_px": 0.5} for n in (2, 6)]
    found = request(markers=MARKERS, recordings=recordings)
    assert [(m.number, m.fps) for m in found.modes] == [(2, 200.0), (6, 600.0)]
    assert any("Only modes with a [[recordings]] entry" in text for text in found.assumptions)


def test_the_first_of_several_recordings_of_a_mode_is_planned_and_named():
    recordings = [{"file": f"{fps}.avi", "mode": 2, "fps": fps, "mm_per_px": 1.0} for fps in (120, 240)]
    found = request(markers=MARKERS, recordings=recordings)
    assert [m.fps for m in found.modes] == [120.0]
    assert any("the settings of 120.avi are used" in text for text in found.assumptions)


def test_plan_is_a_public_function_whose_example_is_right(monkeypatch):
    assert modalcam.plan is plan
    assert "plan" in dir(modalcam)
    monkeypatch.chdir(ROOT)
    failed, tried = doctest.testmod(importlib.import_module("modalcam.apps.plan.plan"), verbose=False)
    assert (failed, tried > 0) == (0, True)
