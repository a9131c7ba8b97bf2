"""Convergence of the sampler, mode by mode."""

from __future__ import annotations

from dataclasses import dataclass

from modal_id.results import Identification, IdentifiedMode
from modalcam.report.sections.modes import mode_name
from modalcam.report.style.format import MISSING, fixed, significant, with_sd


@dataclass(frozen=True)
class SamplerRow:
    """One mode's posterior as the table shows it."""

    mode: str
    draws: str
    r_hat: str
    ess: str
    steps: str
    acceptance: str
    noise_factor: str
    systematic: str
    laplace: str


def sampler_rows(found: Identification) -> tuple[SamplerRow, ...]:
    """A row for each mode."""
    return tuple(_row(mode) for mode in found.modes)


def dependence_text(mode: IdentifiedMode) -> str:
    """What is known of how frequency and damping follow the amplitude."""
    dependence = mode.amplitude_dependence
    if dependence is None:
        return ""
    values = (
        f"ζ(a) = ({with_sd(100.0 * dependence.zeta0, 100.0 * dependence.zeta0_sd)}) % + "
        f"({with_sd(100.0 * dependence.zeta1, 100.0 * dependence.zeta1_sd)}) % · a and "
        f"f(a) = ({with_sd(dependence.f0_hz, dependence.f0_sd_hz)}) Hz + "
        f"({with_sd(dependence.f2_hz, dependence.f2_sd_hz)}) Hz · a², a being the amplitude relative "
        "to the start of the fit"
    )
    if dependence.significant:
        return f"Damping or frequency depends on amplitude: {values}. The intervals of the constants were widened."
    return f"No dependence on amplitude was found ({values})."


def _row(mode: IdentifiedMode) -> SamplerRow:
    posterior = mode.posterior
    ensembles, draws = posterior.frequency_hz.shape
    return SamplerRow(
        mode=mode_name(mode),
        draws=f"{ensembles} × {draws}",
        r_hat=" / ".join(fixed(v, 3) for v in posterior.r_hat),
        ess=" / ".join(fixed(v, 0) for v in posterior.ess),
        steps=significant(posterior.autocorrelation_steps, 2),
        acceptance=fixed(posterior.acceptance, 2),
        noise_factor=fixed(posterior.noise_factor, 2),
        systematic=_systematic(mode),
        laplace=_laplace(mode),
    )


def _systematic(mode: IdentifiedMode) -> str:
    f, z = mode.posterior.systematic_frequency_hz, mode.posterior.systematic_damping_ratio
    if f == 0.0 and z == 0.0:
        return "none"
    return f"{significant(f, 2)} Hz / {significant(100.0 * z, 2)} %"


def _laplace(mode: IdentifiedMode) -> str:
    f, z = mode.posterior.laplace_sd
    if not (f > 0.0 and z > 0.0):
        return MISSING
    return f"{fixed(mode.frequency_sd_hz / f, 2)} / {fixed(mode.damping_ratio_sd / z, 2)}"
