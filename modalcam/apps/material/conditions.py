"""What the equations assume of a specimen, and whether it holds."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from modal_id.modes import combine
from modalcam.apps.material.specimen import LAYERED, BarMode, Specimen

E756, E1876 = "ASTM E756-05(2017)", "ASTM E1876 and ISO 12680-1"
HOLDS, FAILS, UNKNOWN = "holds", "does not hold", "not known"


@dataclass(frozen=True)
class Tuning:
    """Limits of the conditions."""

    #: [Hz] lowest frequency for which E756 is meant
    #: convention: ASTM E756-05(2017), scope.
    lowest_hz: float = 50.0
    #: [Hz] highest frequency for which E756 is meant
    #: convention: ASTM E756-05(2017), scope.
    highest_hz: float = 5000.0
    #: [1] least ratio of length to thickness of a free bar
    #: convention: ASTM E1876, as guides to impulse excitation quote it, which advise 20.
    least_slenderness: float = 5.0
    #: [1] error of a modulus by gravity, masses and clamp below which the equations count as valid without correction
    #: convention: Chosen: the effect of 0.5 % in thickness, 10 um of 2 mm.
    negligible: float = 0.01


TUNING = Tuning()


@dataclass(frozen=True)
class MaterialValue:
    """A row of ``material.csv``, whose columns are these attributes; `mode` is None for a value that has none."""

    mode: int | str | None
    frequency_hz: float
    frequency_sd_hz: float
    quantity: str
    unit: str
    value: float
    sd: float
    q05: float
    q95: float
    largest_source: str
    share: float
    equations: str
    remarks: str


@dataclass(frozen=True)
class Condition:
    """Something that the equations assume, whether it holds, and what it amounts to here."""

    state: str
    text: str


def conditions(
    specimen: Specimen, modes: Sequence[BarMode], values: Sequence[MaterialValue]
) -> Iterator[Condition]:
    """Conditions of the equations for a kind of specimen, with the state of each."""
    sizes = {name: value.value for name, value in specimen.given().items()}
    if specimen.kind == "free-free":
        ratio, least = sizes["length_mm"] / sizes["thickness_mm"], TUNING.least_slenderness
        text = f"Length at least {least:g} times the thickness, better 20 times"
        yield Condition(HOLDS if ratio >= least else FAILS, f"{text}: it is {ratio:.3g} times.")
        yield Condition(UNKNOWN, "Supports at 0.224 of the length from either end, the nodes of mode 1.")
        outside = [v for v in values if v.quantity == "poisson_ratio" and (v.q95 < -1.0 or v.q05 > 0.5)]
        wrong = f"a Poisson's ratio of {outside[0].value:.3g} is outside -1 to 0.5" if outside else ""
        yield _condition("Homogeneous, isotropic, elastic material", wrong, UNKNOWN)
    else:
        hz = {v.mode: v.frequency_hz for v in values}
        text = f"Frequencies from {TUNING.lowest_hz:g} to {TUNING.highest_hz:g} Hz"
        yield _condition(
            text, _listed(n for n, f in hz.items() if not TUNING.lowest_hz <= f <= TUNING.highest_hz)
        )
        text = "The clamp is rigid and the free length begins at it. 1 mm of bar that moves inside the jaws, or a clamp"
        yield Condition(
            UNKNOWN, f"{text} as compliant as it, lowers E by {400.0 / sizes['length_mm']:.2g} %."
        )
    if specimen.kind in LAYERED:
        weak = _listed(v.mode for v in values if v.quantity in ("E1", "G1") and v.q05 <= 0.0)
        text = "The layer changes the frequency by more than the errors"
        yield _condition(text, weak and f"the interval of its modulus reaches 0 in {weak}")
        yield Condition(UNKNOWN, "Gravity and added masses are negligible; both bars have the same clamp.")
    elif specimen.kind == "bar":
        yield from _of_beam_theory(values)
    dependent = _listed(m.number for m in modes if any("AMPLITUDE_DEPENDENT" in one for one in m.remarks))
    yield _condition("Frequency and damping do not depend on the amplitude", dependent, UNKNOWN)
    yield Condition(
        UNKNOWN, "Air and supports dissipate nothing; otherwise the loss factor is an upper limit."
    )


def _of_beam_theory(values: Sequence[MaterialValue]) -> Iterator[Condition]:
    found, corrected = ([v for v in values if v.quantity == name] for name in ("E", "E_corrected"))
    if corrected:
        plain = {v.mode: v.value for v in found}
        wrong = {v.mode: plain[v.mode] / v.value - 1.0 for v in corrected}
        listed = ", ".join(f"{100.0 * error:+.2g} % (mode {n})" for n, error in wrong.items())
        state = FAILS if max(map(abs, wrong.values())) > TUNING.negligible else HOLDS
        text = "Gravity, point masses and the clamp of [beam] are negligible"
        yield Condition(state, f"{text}: they change E by {listed}.")
    else:
        yield Condition(UNKNOWN, "Gravity and added masses are negligible.")
    best = corrected or found
    if len(best) < 2:
        yield Condition(UNKNOWN, "Uniform bar, rigid clamp: two modes would show whether they agree in E.")
        return
    # Only the errors of the frequencies differ between modes; combine takes none of zero.
    own = [v.value * float(np.fmax(2.0 * v.frequency_sd_hz / v.frequency_hz, 1e-9)) for v in best]
    e = [v.value for v in best]
    spread = float(np.ptp(e) / np.mean(e))
    differ = spread > TUNING.negligible and combine(e, own).disagree
    text = f"Uniform bar, rigid clamp: the modes {'differ' if differ else 'agree'} in E within {100.0 * spread:.2g} %."
    suspect = " The clamp is the first suspect, then taper and masses that [beam] lacks." if differ else ""
    yield Condition(FAILS if differ else HOLDS, text + suspect)


def without_sd(specimen: Specimen, *modes: Iterable[BarMode]) -> Iterator[str]:
    """A sentence on values without a standard deviation."""
    exact = [name for name, value in specimen.given().items() if np.isnan(value.sd)]
    # No equation of a clamped bar has its width.
    names = [name for name in exact if name != "width_mm" or specimen.kind == "free-free"]
    of_modes = [q for some in modes for m in some for q in (m.frequency_hz, m.damping_ratio) if q is not None]
    if any(np.isnan(q.sd) for q in of_modes):
        names.append("some frequencies or damping ratios")
    if names:
        yield (
            f"Moduli and other values that are computed from {', '.join(names)} have no interval, since these have no "
            "standard deviation: set length_sd_mm, thickness_sd_mm and density_sd_kg_m3 in [beam], or give VALUE+-SD."
        )


def _condition(text: str, wrong: str, otherwise: str = HOLDS) -> Condition:
    return Condition(FAILS, f"{text}: not so, {wrong}.") if wrong else Condition(otherwise, f"{text}.")


def _listed(numbers: Iterable[object]) -> str:
    listed = ", ".join(map(str, dict.fromkeys(numbers)))
    return listed and f"mode {listed}"
