"""Terms and flags of the report explained: the single source of the report's glossary and of docs/glossary.md."""

from __future__ import annotations

from dataclasses import dataclass

from modal_id.flags import ModeFlag
from tracker.flags import REGISTRY as FRAME_FLAGS


@dataclass(frozen=True)
class Term:
    """A term or flag and its meaning; `anchor` is its id in the report."""

    anchor: str
    name: str
    text: str


TERMS = (
    Term(
        "term-zeta",
        "ζ, damping ratio",
        "Damping as a share of critical damping, in percent. Each cycle reduces the amplitude by the factor "
        "exp(−2πζ / √(1 − ζ²)), which is about 6.3 ζ for light damping.",
    ),
    Term(
        "term-omega",
        "ωₙ and ω_d",
        "Undamped and damped angular frequency, ω_d = ωₙ √(1 − ζ²). Frequencies in this report are undamped, ωₙ / 2π.",
    ),
    Term(
        "term-interval",
        "± and intervals",
        "± is one standard deviation. “90 %” is the central 90 % credible interval, from the 5 % to the 95 % quantile "
        "of the posterior. Values are rounded to two significant digits of their standard deviation.",
    ),
    Term(
        "term-target",
        "target",
        "The mode that the recording was made to measure. Other modes that were also excited are fitted "
        "simultaneously, so that they do not bias it.",
    ),
    Term(
        "term-onset",
        "onset",
        "The instant at which the excitation ends and the free decay begins. The fit starts just after it.",
    ),
    Term(
        "term-mac",
        "MAC",
        "Modal assurance criterion: 1 if the measured mode shape is proportional to the theoretical one, 0 if the two "
        "are orthogonal.",
    ),
    Term(
        "term-mpc",
        "MPC",
        "Modal phase collinearity: 1 if all markers move in phase or in antiphase, as in a normal mode.",
    ),
    Term(
        "term-r-hat",
        "R̂",
        "Convergence diagnostic that compares independent ensembles of the sampler: 1.00 when they agree. Inspect the "
        "trace above 1.01.",
    ),
    Term(
        "term-ess",
        "ESS",
        "Effective sample size: the number of independent draws with the same information as the correlated draws.",
    ),
    Term(
        "term-noise-factor",
        "noise factor",
        "Amplitude ratio of the residual’s spectrum near the mode to white noise of the same variance.",
    ),
    Term(
        "term-log-density",
        "log predictive density",
        "Logarithm of the probability density that a model assigns to the measured samples, in nats. Higher is better; "
        "confident wrong predictions are penalised heavily.",
    ),
    Term(
        "term-crps",
        "CRPS",
        "Continuous ranked probability score: distance between the predicted distribution and the sample, in the unit "
        "of the sample. Lower is better; for a single predicted value it equals the absolute error.",
    ),
    Term(
        "term-nrmse",
        "nrmse",
        "rms of simulated minus measured displacement, divided by the rms of the measured displacement; 0 is perfect.",
    ),
)


def mode_flag_terms() -> tuple[Term, ...]:
    """Every flag that a mode can carry, in the words of its registry."""
    return tuple(Term(f"flag-{flag.name}", flag.name, flag.value) for flag in ModeFlag)


def frame_flag_terms() -> tuple[Term, ...]:
    """Every flag that a marker in a frame can carry, in the words of its registry."""
    return tuple(Term(f"flag-{flag.name}", flag.name, flag.description) for flag in FRAME_FLAGS)
