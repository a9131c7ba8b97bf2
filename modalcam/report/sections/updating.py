"""The beam as configured and as updated in three ways (Table 3 of the paper)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from modal_id.results import Identification, IdentifiedMode
from modalcam.pipeline.results import BeamResult, RunResult
from modalcam.report.style.format import significant, superscript
from sim.updating import Updating, variable_names
from tracker.arrays import FloatArray

_UNIFORM = ("width", "thickness", "density", "modulus")
# Exponents below this are zero.
_NO_EXPONENT = 0.05
_NAN = float("nan")


class UpdatingRow(NamedTuple):
    """Frequencies of one mode in Hz: measured with sd, as configured, updated in three ways."""

    number: int
    measured: float
    measured_sd: float
    standard: float
    paper: float = _NAN
    uniform: float = _NAN
    posterior: float = _NAN
    low: float = _NAN
    high: float = _NAN
    posterior_sd: float = _NAN

    def error(self, value: float) -> float:
        """Deviation of `value` from the measured frequency in percent."""
        return 100.0 * (value / self.measured - 1.0)


def updating_rows(result: RunResult) -> tuple[UpdatingRow, ...]:
    """Modes of the posterior, measured or not; the first five of the beam where nothing was updated."""
    if result.beam is None:
        return ()
    standard, updated = result.beam.standard_modes.frequency_hz, result.beam.updated
    if updated is not None:
        last = min(updated.bayesian.predicted_hz.shape[1], standard.size)
        return tuple(_updated_row(n, updated, float(standard[n - 1])) for n in range(1, last + 1))
    measured = measured_by_number(result)
    rows = []
    for n in range(1, min(max([*measured, 5]), standard.size) + 1):
        mode = measured.get(n)
        f, sd = (_NAN, _NAN) if mode is None else (mode.frequency_hz, mode.frequency_sd_hz)
        rows.append(UpdatingRow(n, f, sd, float(standard[n - 1])))
    return tuple(rows)


def measured_by_number(result: RunResult) -> dict[int, IdentifiedMode]:
    """The measured mode of each number: targets first, then the smallest standard deviation."""
    best: dict[int, IdentifiedMode] = {}
    for recording in result.recordings:
        if isinstance(recording.identification, Identification):
            for mode in recording.identification.modes:
                if mode.number is not None:
                    best[mode.number] = max(
                        best.get(mode.number, mode), mode, key=lambda m: (m.target, -m.frequency_sd_hz)
                    )
    return best


def _updated_row(number: int, updated: Updating, standard: float) -> UpdatingRow:
    draws = updated.predicted_hz[:, number - 1]
    low, median, high = (float(q) for q in np.quantile(draws, [0.05, 0.5, 0.95]))
    posterior = {"posterior": median, "low": low, "high": high, "posterior_sd": float(np.std(draws))}
    at = np.flatnonzero(updated.mode_numbers == number)
    if not at.size:
        return UpdatingRow(number, _NAN, _NAN, standard, **posterior)
    columns = (updated.measured_hz, updated.measured_sd_hz)
    f, sd = (float(column[at[0]]) for column in columns)
    paper, uniform = (float(one.updated_hz[at[0]]) for one in (updated.paper, updated.uniform))
    return UpdatingRow(number, f, sd, standard, paper, uniform, **posterior)


def updating_numbers(beam: BeamResult) -> dict[str, Any]:
    """Numbers of the paragraphs on updating; empty where nothing was updated."""
    updated = beam.updated
    if updated is None:
        return {}
    paper, uniform, posterior = updated.paper, updated.uniform, updated.bayesian
    ratio, elements = posterior.variance_ratio, (posterior.variance_ratio.size - 2) // 2
    density, modulus = posterior.properties.density_kg_m3, posterior.properties.elastic_modulus_pa
    centre = np.array([[density], [modulus]]) / np.exp(posterior.log_factor[-2:, np.newaxis])
    strain = np.abs(posterior.log_factor) / posterior.prior.sd
    strained = int(np.argmax(strain))
    median_hz = np.median(posterior.predicted_hz, axis=0)
    unmeasured = [n for n in range(1, median_hz.size + 1) if n not in updated.mode_numbers]
    spreads = (
        np.std(posterior.predicted_hz, axis=0),
        np.std(updated.predicted_hz, axis=0),
        posterior.prior_sd_hz,
    )
    return {
        "paper_error": float(np.max(np.abs(paper.updated_hz / updated.measured_hz - 1.0))),
        "start_spread": float(np.sqrt(np.mean(paper.start_spread**2))),
        "uniform_errors": 100.0 * (uniform.updated_hz / updated.measured_hz - 1.0),
        "combinations": [combination(row) for row in uniform.combinations[: uniform.known]],
        "width": ratio[:elements],
        "thickness": ratio[elements : 2 * elements],
        "material": posterior.factor_interval()[-2:] * centre,
        "strain": float(strain[strained]),
        "strained": variable_names(elements)[strained],
        "strained_change": 100.0 * float(np.exp(posterior.log_factor[strained]) - 1.0),
        "unmeasured": [(n, *(float(sd[n - 1] / median_hz[n - 1]) for sd in spreads)) for n in unmeasured],
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
