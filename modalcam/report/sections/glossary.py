"""Words and flags explained; the text of a flag is that of its registry."""

from __future__ import annotations

from dataclasses import dataclass

from modal_id.flags import REGISTRY as MODE_FLAGS
from tracker.flags import REGISTRY as FRAME_FLAGS

_TERMS = (
    (
        "ζ, damping ratio",
        (
            "Part of critical damping, given in percent. From one cycle to the next the amplitude falls by the factor "
            "exp(−2πζ / √(1 − ζ²)), that is by about 6.3 ζ of itself."
        ),
    ),
    (
        "ωₙ and ω_d",
        "Undamped and damped angular frequency, ω_d = ωₙ √(1 − ζ²). Frequencies in this report are ωₙ / 2π.",
    ),
    (
        "± and intervals",
        (
            "± is one standard deviation. “90 %” is the central 90 % credible interval, from the 5 % "
            "to the 95 % quantile "
            "of the posterior. Values are rounded to two digits of their standard deviation."
        ),
    ),
    (
        "target",
        (
            "The mode that a recording was made for. Other modes that rang along were fitted too, so that they cannot "
            "bias it."
        ),
    ),
    (
        "MAC",
        (
            "Modal assurance criterion: 1 when the measured shape is the theoretical one up to a factor, "
            "0 when the two are orthogonal."
        ),
    ),
    ("R̂", "Compares independent ensembles of the sampler; 1.00 when they agree, above 1.01 to be looked at."),
    ("ESS", "Effective sample size: the number of independent draws that the correlated ones are worth."),
    (
        "noise factor",
        "By how much the residual's spectrum near the mode exceeds white noise of the same variance, as an amplitude.",
    ),
    (
        "log predictive density",
        (
            "Logarithm of the probability density that a model gives the samples, in nats; the larger the better. "
            "A model that is sure and wrong loses by far."
        ),
    ),
    (
        "CRPS",
        (
            "Continuous ranked probability score: how far the predicted distribution lies from the sample, in its "
            "unit; the smaller the better, and the absolute error where the prediction is one value."
        ),
    ),
    (
        "nrmse",
        "rms of simulated minus measured displacement, over the rms of the measured displacement; 0 is perfect.",
    ),
)


@dataclass(frozen=True)
class Term:
    """A word or flag and its meaning; `anchor` is what links point to."""

    anchor: str
    name: str
    text: str


def terms() -> tuple[Term, ...]:
    """Words of the report in reading order."""
    return tuple(Term(f"term-{index}", name, text) for index, (name, text) in enumerate(_TERMS, start=1))


def mode_flag_terms() -> tuple[Term, ...]:
    """Every flag that a mode can carry."""
    return tuple(_flag(flag.name, flag.description) for flag in MODE_FLAGS)


def frame_flag_terms() -> tuple[Term, ...]:
    """Every flag that a marker in a frame can carry."""
    return tuple(_flag(flag.name, flag.description) for flag in FRAME_FLAGS)


def _flag(name: str, text: str) -> Term:
    return Term(f"flag-{name}", name, text)
