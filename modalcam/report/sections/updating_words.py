"""What updating found, in sentences: what the data decide, what the prior, and which kind of beam they speak for."""

from __future__ import annotations

import numpy as np

from modalcam.report.style.format import count, fixed, percent, significant
from sim.updating import Updating, variable_names
from tracker.arrays import FloatArray

_NAMES = {"uniform": "a uniform beam", "taper": "a linear taper", "smooth": "smooth fields"}
_UNIFORM = ("width", "thickness", "density", "modulus")
# An exponent below this is none
_NO_EXPONENT = 0.05
_SUPERSCRIPT = str.maketrans("0123456789.", "⁰¹²³⁴⁵⁶⁷⁸⁹·")
# Variables that are named as the paper's at their bound before the rest is counted
_NAMED = 6
_NOTHING = 1e-5
# Answers nearer than this share are one
_SAME_ANSWER = 0.01
# Prior standard deviations beyond which a property of 42 is not chance
_STRAINED = 3.5


def updating_words(updated: Updating) -> tuple[str, ...]:
    """Sentences in the order of the table's columns."""
    return (
        _paper(updated),
        _start(updated),
        _uniform(updated),
        _decided(updated),
        _predicted(updated),
        _strained(updated),
        _shapes(updated),
        _favoured(updated),
        _checked(updated),
    )


def _paper(updated: Updating) -> str:
    paper = updated.paper
    error = float(np.max(np.abs(paper.updated_hz / updated.measured_hz - 1.0)))
    left = f"at most {percent(error)}" if error > _NOTHING else "less than 0.001 %"
    text = (
        f"As the paper does it, without gravity, {count(paper.start_spread.size, 'variable')} within "
        f"{percent(paper.bound)} leave {left} in frequency"
    )
    if paper.at_bound:
        named = ", ".join(paper.at_bound[:_NAMED])
        rest = len(paper.at_bound) - _NAMED
        more = f" and {rest} more" if rest > 0 else ""
        text += f"; {count(len(paper.at_bound), 'variable')} end at their bound: {named}{more}"
    if np.isfinite(paper.smallest_bound):
        text += f". No fields within less than {percent(paper.smallest_bound)} reach the frequencies without gravity"
    return text


def _start(updated: Updating) -> str:
    spread = float(np.sqrt(np.mean(updated.paper.start_spread**2)))
    if spread < _SAME_ANSWER:
        return f"Searches from other starts end within {percent(spread)} of it in a variable (rms)"
    return (
        "That answer is the one nearest to the beam as configured: searches from other starts end elsewhere, "
        f"{percent(spread)} away in a variable (rms)"
    )


def _uniform(updated: Updating) -> str:
    uniform = updated.uniform
    error = 100.0 * (uniform.updated_hz / updated.measured_hz - 1.0)
    known = ", ".join(_combination(row) for row in uniform.combinations[: uniform.known])
    text = (
        f"The same change everywhere, with gravity as mounted (thickness × {fixed(uniform.thickness_factor, 3)}), "
        f"leaves {_signed(error.min())} to {_signed(error.max())} %"
    )
    return text + (f". Of uniform properties the modes tell only {known}" if known else "")


def _combination(exponents: FloatArray) -> str:
    """Product of powers, the smallest exponent 1."""
    scale = np.min(np.abs(exponents[np.abs(exponents) > _NO_EXPONENT]))
    above: list[str] = []
    below: list[str] = []
    for name, power in zip(_UNIFORM, exponents / scale, strict=True):
        if abs(power) > _NO_EXPONENT:
            shown = significant(abs(float(power)), 2).removesuffix(".0").translate(_SUPERSCRIPT)
            (above if power > 0.0 else below).append(name if shown == "¹" else name + shown)
    return " · ".join(above or ["1"]) + "".join(f" / {name}" for name in below)


def _decided(updated: Updating) -> str:
    posterior = updated.bayesian
    ratio = posterior.variance_ratio
    ne = (ratio.size - 2) // 2
    return (
        f"The measured modes determine {count(posterior.determined, 'direction')} of the "
        f"{ratio.size} properties; the other {posterior.undetermined} are the prior's (relative standard deviation "
        f"{percent(posterior.prior.sd)}, correlated over {percent(posterior.prior.correlation_length)} of the length). "
        "Posterior over prior variance: "
        f"thickness of an element {_range(ratio[ne : 2 * ne])}, width {_range(ratio[:ne])}, "
        f"density {fixed(float(ratio[-2]), 2)}, modulus {fixed(float(ratio[-1]), 2)} (1 is the prior alone)"
    )


def _range(values: FloatArray) -> str:
    return f"{fixed(float(values.min()), 2)} to {fixed(float(values.max()), 2)}"


def _predicted(updated: Updating) -> str:
    posterior = updated.bayesian
    numbers = [n for n in range(1, posterior.predicted_hz.shape[1] + 1) if n not in updated.mode_numbers]
    if not numbers:
        return ""
    sd, with_discrepancy = np.std(posterior.predicted_hz, axis=0), np.std(updated.predicted_hz, axis=0)
    found = [
        percent(float(with_discrepancy[n - 1] / np.median(posterior.predicted_hz[:, n - 1]))) for n in numbers
    ]
    shares = [
        f"{percent(float(sd[n - 1] / np.median(posterior.predicted_hz[:, n - 1])))} (mode {n})"
        for n in numbers
    ]
    before = [
        percent(float(posterior.prior_sd_hz[n - 1] / np.median(posterior.predicted_hz[:, n - 1])))
        for n in numbers
    ]
    return (
        f"Modes that were not measured are predicted with a standard deviation of {', '.join(shares)} if the model "
        f"is true, of {', '.join(found)} with the discrepancy that the evidence leaves likely (the table has this); "
        f"the prior alone has {', '.join(before)}"
    )


def _strained(updated: Updating) -> str:
    """Where the data ask for what the prior holds improbable."""
    posterior = updated.bayesian
    strain = np.abs(posterior.log_factor) / posterior.prior.sd
    at = int(np.argmax(strain))
    if strain[at] < _STRAINED:
        return ""
    change = 100.0 * (np.exp(posterior.log_factor[at]) - 1.0)
    name = variable_names((posterior.log_factor.size - 2) // 2)[at]
    return (
        f"The measured modes ask for what the prior holds improbable: {name} changes by {_signed(change)} %, "
        f"{significant(float(strain[at]), 2)} standard deviations. Something there may be missing in the model, "
        "such as a glued mass"
    )


def _shapes(updated: Updating) -> str:
    if np.isnan(updated.bayesian.shape_rms):
        return "No shapes were measured: frequencies alone decide"
    paper, uniform, posterior = (
        significant(one.shape_rms, 2) for one in (updated.paper, updated.uniform, updated.bayesian)
    )
    return (
        f"Measured shapes are missed by {paper} standard deviations (rms) as the paper does it, by {uniform} "
        f"with uniform properties, by {posterior} at the most probable beam"
    )


def _favoured(updated: Updating) -> str:
    evidence = updated.evidence
    best, *others = evidence.undecided
    text = f"Of the kinds of beam compared the measured modes speak most for {_model(best)}"
    if others:
        text += (
            f", and do not decide against {' or '.join(_model(name) for name in others)} (odds below 3 to 1)"
        )
    return text


def _checked(updated: Updating) -> str:
    posterior = updated.bayesian
    worst = max(abs(model.laplace_error) for model in updated.evidence.models)
    text = (
        f"The posterior is {count(posterior.log_factor_draws.shape[0], 'independent draw')} with exact frequencies, "
        f"worth {significant(posterior.effective_draws, 3)}; Laplace's approximation of each log evidence agrees "
        f"with weighted draws within {significant(worst, 2)}"
    )
    if not posterior.reliable:
        text += ". So few effective draws do not represent it: do not trust the intervals"
    return text


def _model(name: str) -> str:
    kind, _, gravity = name.partition("+")
    return f"{_NAMES[kind]} {'with' if gravity else 'without'} gravity"


def _signed(value: float) -> str:
    return f"{'+' if value > 0.0 else ''}{fixed(float(value), 2)}"
