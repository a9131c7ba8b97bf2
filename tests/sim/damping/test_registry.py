"""A damping model registered outside the package is built, compared and reported like the others."""

import numpy as np
import pytest

from modalcam.config import ExperimentConfig
from modalcam.pipeline import damping_candidates
from modalcam.report.style import style_sheet, variables
from sim import paper_beam
from sim.damping import (
    DAMPING_MODELS,
    DampingModelEntry,
    GenericDamping,
    MeasuredDamping,
    RayleighDamping,
    rayleigh_to_all,
    register_damping_model,
    selectable_damping_models,
    skipped_damping_models,
)

MEASURED = MeasuredDamping(
    (1, 2), (1.9, 10.1), (0.01, 0.004), ((1.8, 1.9, 2.0), (10.0, 10.1, 10.2)), ((0.009, 0.01, 0.011),) * 2
)


def mean_of(measured, omega_rad_s):
    return GenericDamping((float(np.mean(measured.damping_ratio)),) * len(omega_rad_s))


def entry(**changes):
    given = {
        "key": "mean_ratio",
        "name": "mean damping",
        "description": "The same ratio for every mode.",
        "colour": "#123456",
        "dark_colour": "#abcdef",
        "build": mean_of,
        "marker": "P",
        "draw_stride": 2,
    }
    return DampingModelEntry(**{**given, **changes})


@pytest.fixture
def mean_ratio():
    register_damping_model(entry())
    yield "mean_ratio"
    del DAMPING_MODELS["mean_ratio"]


def test_registered_model_can_be_selected_and_is_built_for_every_draw(mean_ratio):
    config = ExperimentConfig.model_validate({"damping": {"models": ["rayleigh", mean_ratio]}})
    candidates = damping_candidates(config.damping.models, paper_beam(), MEASURED)
    assert list(candidates) == ["rayleigh", "mean_ratio"]
    assert candidates["mean_ratio"].model == GenericDamping((0.007, 0.007))
    assert len(candidates["mean_ratio"].draws) == 2
    assert len(candidates["rayleigh"].draws) == 3
    assert isinstance(candidates["rayleigh"].draws[0], RayleighDamping)


@pytest.mark.usefixtures("mean_ratio")
def test_report_uses_the_colours_of_the_registry():
    assert variables()["#123456"] == "--damping-mean_ratio"
    page = style_sheet()
    assert "--damping-mean_ratio: #123456" in page
    assert "--damping-mean_ratio: #abcdef" in page
    assert "td.mean_ratio { color: var(--damping-mean_ratio); }" in page


def test_keys_and_colours_are_unique():
    with pytest.raises(ValueError, match="its key or its colour #0067a5 is that of 'generic'"):
        register_damping_model(entry(colour="#0067a5"))
    with pytest.raises(ValueError, match="is that of 'rayleigh'"):
        register_damping_model(entry(key="rayleigh"))
    assert "mean_ratio" not in DAMPING_MODELS


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"key": "Mean ratio"}, "lower case letters"),
        ({"dark_colour": "red"}, "expected a colour such as"),
        ({"least_modes": 0}, "at least 1"),
    ],
)
def test_invalid_entries_are_refused(changes, expected):
    with pytest.raises(ValueError, match=expected):
        entry(**changes)


def test_model_with_too_few_modes_is_excluded_with_the_reason():
    one = MeasuredDamping((1,), (1.9,), (0.01,), ((1.9,),), ((0.01,),))
    chosen = ("generic", "rayleigh", "rayleigh_constant_k")
    assert list(damping_candidates(chosen, paper_beam(), one)) == ["generic"]
    assert skipped_damping_models(chosen, one) == (
        "Rayleigh damping (Eq. 4) needs two identified modes; 1 identified: not simulated.",
    )
    assert skipped_damping_models(chosen, MEASURED) == ()


def test_air_drag_is_fitted_and_cannot_be_selected():
    assert "air_drag" in DAMPING_MODELS
    assert set(selectable_damping_models()) == DAMPING_MODELS.keys() - {"air_drag"}


@pytest.mark.parametrize(
    ("models", "expected"),
    [
        (["raileigh"], "expected a damping model, one of rayleigh; found 'raileigh'"),
        (["air_drag"], "expected a damping model"),
        (["generic", "generic"], "each damping model once"),
        ([], "at least 1 item"),
    ],
)
def test_configuration_accepts_models_of_the_registry_only(models, expected):
    with pytest.raises(ValueError, match=expected):
        ExperimentConfig.model_validate({"damping": {"models": models}})


@pytest.mark.parametrize(
    ("frequency_hz", "damping_ratio"),
    [
        ((1.85, 10.19, 26.84, 53.19, 88.59), (9.99e-3, 2.8e-3, 2.8e-3, 2.31e-3, 2.99e-3)),
        ((1.85, 10.19, 26.84), (9.99e-3, 5e-4, 2e-4)),
    ],
    ids=["as in the paper", "falls faster than alpha"],
)
def test_rayleigh_damping_fitted_to_all_modes_is_the_least_squares_optimum(frequency_hz, damping_ratio):
    """With alpha, beta >= 0 the gradient vanishes where a coefficient is free and is positive at a bound."""
    measured = MeasuredDamping(tuple(range(1, len(frequency_hz) + 1)), frequency_hz, damping_ratio)
    fitted = rayleigh_to_all(measured)
    omega, ratios = 2.0 * np.pi * np.array(frequency_hz), np.array(damping_ratio)
    columns = np.stack([0.5 / omega, 0.5 * omega])
    size = np.linalg.norm(columns, axis=1) * np.linalg.norm(ratios)
    gradient = columns @ (fitted.damping_ratio(omega) - ratios) / size
    for value, slope in zip((fitted.alpha_1_s, fitted.beta_s), gradient, strict=True):
        assert value >= 0.0
        # Round-off of sums of five terms.
        assert abs(slope) < 1e-13 if value > 0.0 else slope > 0.0


def test_rayleigh_damping_fitted_to_modes_of_rayleigh_damping_is_exact():
    truth = RayleighDamping(0.2, 1e-5)
    frequency_hz = (2.0, 10.0, 50.0)
    ratios = truth.damping_ratio(2.0 * np.pi * np.array(frequency_hz))
    fitted = rayleigh_to_all(MeasuredDamping((1, 2, 3), frequency_hz, tuple(ratios)))
    np.testing.assert_allclose((fitted.alpha_1_s, fitted.beta_s), (0.2, 1e-5), rtol=1e-12)
