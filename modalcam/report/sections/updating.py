"""The beam as configured and as updated in three ways (Table 3 of the paper)."""

from __future__ import annotations

from typing import Any

import numpy as np

from modalcam.pipeline import BeamResult, RunResult
from modalcam.report.signals import best_modes
from modalcam.report.style import significant, superscript
from sim.updating import Updating, variable_names
from tracker import INTERVAL_ENDS, FloatArray

_UNIFORM = ("width", "thickness", "density", "modulus")
# Exponents below this are zero.
_NO_EXPONENT = 0.05


def updating_rows(result: RunResult) -> list[dict[str, Any]]:
    """Frequencies of each mode in Hz: measured with sd, as configured, and where the beam was updated in three ways.

    Modes of the posterior, measured or not; the first five of the beam where nothing was updated.
    """
    if result.beam is None:
        return []
    standard, updated = result.beam.standard_modes.frequency_hz, result.beam.updated
    if updated is not None:
        last = min(updated.bayesian.predicted_hz.shape[1], standard.size)
        rows = [_updated_row(n, updated) for n in range(1, last + 1)]
    else:
        measured = {
            n: {"measured": mode.frequency_hz, "measured_sd": mode.frequency_sd_hz}
            for n, (_, mode) in best_modes(result).items()
        }
        nothing = {"measured": np.nan, "measured_sd": np.nan}
        rows = [measured.get(n, nothing) for n in range(1, min(max([*measured, 5]), standard.size) + 1)]
    return [{"number": n, "standard": float(standard[n - 1])} | row for n, row in enumerate(rows, 1)]


def _updated_row(number: int, updated: Updating) -> dict[str, Any]:
    draws = updated.predicted_hz[:, number - 1]
    at = updated.mode_numbers == number
    columns = {
        "measured": updated.measured_hz,
        "measured_sd": updated.measured_sd_hz,
        "paper": updated.paper.updated_hz,
        "uniform": updated.uniform.updated_hz,
    }
    low, median, high = np.quantile(draws, (INTERVAL_ENDS[0], 0.5, INTERVAL_ENDS[1]))
    values = {name: values[at][0] if at.any() else np.nan for name, values in columns.items()}
    return values | {"low": low, "posterior": median, "high": high, "posterior_sd": np.std(draws)}


def updating_numbers(beam: BeamResult) -> dict[str, Any]:
    """Numbers of the paragraphs on updating; empty where nothing was updated."""
    updated = beam.updated
    if updated is None:
        return {}
    paper, uniform, posterior = updated.paper, updated.uniform, updated.bayesian
    ratio, elements = posterior.variance_ratio, posterior.properties.elements
    density, modulus = posterior.properties.density_kg_m3, posterior.properties.elastic_modulus_pa
    centre = np.array([[density], [modulus]]) / np.exp(posterior.log_factor[-2:, np.newaxis])
    strain = np.abs(posterior.log_factor) / posterior.prior.sd
    strained = int(np.argmax(strain))
    median_hz = np.median(posterior.predicted_hz, axis=0)
    spreads = np.array(
        [np.std(posterior.predicted_hz, axis=0), np.std(updated.predicted_hz, axis=0), posterior.prior_sd_hz]
    )
    unmeasured = [n for n in range(1, median_hz.size + 1) if n not in updated.mode_numbers]
    return {
        "paper_error": np.max(np.abs(paper.updated_hz / updated.measured_hz - 1.0)),
        "start_spread": np.sqrt(np.mean(paper.start_spread**2)),
        "uniform_errors": 100.0 * (uniform.updated_hz / updated.measured_hz - 1.0),
        "combinations": [combination(row) for row in uniform.combinations[: uniform.known]],
        "width": ratio[:elements],
        "thickness": ratio[elements : 2 * elements],
        "material": posterior.factor_interval()[-2:] * centre,
        "strain": strain[strained],
        "strained": variable_names(elements)[strained],
        "strained_change": 100.0 * (np.exp(posterior.log_factor[strained]) - 1.0),
        "unmeasured": [(n, *(spreads / median_hz)[:, n - 1]) for n in unmeasured],
        "laplace_error": max(abs(model.laplace_error) for model in updated.evidence.models),
    }


def combination(exponents: FloatArray) -> str:
    """Product of powers of the uniform properties, scaled to a smallest exponent of 1."""
    scale = np.min(np.abs(exponents[np.abs(exponents) > _NO_EXPONENT]))
    above: list[str] = []
    below: list[str] = []
    for name, power in zip(_UNIFORM, exponents / scale, strict=True):
        if abs(power) > _NO_EXPONENT:
            text = significant(abs(float(power)), 2).removesuffix(".0")
            (above if power > 0.0 else below).append(name if text == "1" else name + superscript(text))
    return " · ".join(above or ["1"]) + "".join(f" / {name}" for name in below)
