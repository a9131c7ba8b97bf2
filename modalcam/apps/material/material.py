"""Moduli and loss factors of a specimen with intervals, and which conditions of the equations hold.

Errors are propagated by Monte Carlo: the dimensions, once for all modes, and each mode's frequency and damping ratio
are drawn, and every draw passes through the equations. Linear propagation suffices for a bare bar, but not for a layer
that hardly changes the frequency: its modulus is a small difference, whose distribution reaches zero.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from modal_id.modes import combine
from modalcam.apps.material import equations
from modalcam.apps.material.specimen import LAYERED, BarMode, Quantity, Specimen, departures
from modalcam.common import InputError
from sim.beam import BeamProperties
from tracker import INTERVAL_ENDS, FloatArray

E756, E1876 = "ASTM E756-05(2017)", "ASTM E1876 and ISO 12680-1"
HOLDS, FAILS, UNKNOWN = "holds", "does not hold", "not known"


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


@dataclass(frozen=True)
class Tuning:
    """Propagation of errors, and limits of the conditions."""

    #: [draws] of every measured value
    #: statistics: The ends of a 90 % interval are then within 2 % of the standard deviation (1 sd).
    draws: int = 20_000
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
class Material:
    """What the equations give for a specimen, with notes on what was left out and errors that intervals lack."""

    specimen: Specimen
    values: tuple[MaterialValue, ...]
    conditions: tuple[Condition, ...]
    notes: tuple[str, ...] = ()


def material(
    specimen: Specimen,
    modes: Sequence[BarMode],
    base: Sequence[BarMode] = (),
    *,
    beam: BeamProperties | None = None,
    notes: Sequence[str] = (),
    seed: int = 0,
) -> Material:
    """Moduli and loss factors of a specimen from its modes.

    Parameters
    ----------
    specimen : Specimen
    modes, base : sequence of BarMode
        Of the specimen and, where it has a layer, of the bar without it, each number once. Modes that cannot be used
        are left out with a note: of a free bar all but mode 1, of layers those that only one of both has.
    beam : BeamProperties, optional
        Orientation, point masses and clamp of a bare bar, for the error that leaving them out causes.
    notes : sequence of str
        Further notes.
    seed : int
        Of the draws.

    Raises
    ------
    InputError
        If no mode is left, or a mode is given twice.

    Notes
    -----
    The loss factor, twice the damping ratio, is that of the specimen with air and clamp: an upper limit of the
    material's. The error of a frame rate that both runs of a layered specimen share cancels in the ratio of their
    frequencies, but is counted: those intervals are too wide.
    """
    for numbers, name in (([m.number for m in modes], "--mode"), ([m.number for m in base], "--base-mode")):
        if len(set(numbers)) < len(numbers):
            msg = f"{name}: expected each mode once, found {', '.join(map(str, numbers))}"
            raise InputError(msg)
    made = _Draws(specimen, np.random.default_rng(seed))
    if specimen.kind == "free-free":
        values = list(_free(made, modes, specimen.torsion_hz))
    elif specimen.kind in LAYERED:
        values = list(_layered(made, modes, base, specimen.kind))
    else:
        values = list(_bar(made, modes, specimen, beam))
    if not values:
        needed = "that the bare bar has, too" if specimen.kind in LAYERED else "1 of the free bar"
        listed = ", ".join(str(one.number) for one in modes)
        msg = f"expected a mode {needed}, with a damping ratio for a layer; found modes {listed}; give it with --mode"
        raise InputError(msg)
    left = [m for m in modes if m.number not in {value.mode for value in values}]
    unused = [f"Mode {m.number} ({m.frequency_hz.value:.4g} Hz) is not used." for m in left]
    flags = [f"Mode {m.number}: {remark}." for m in modes for remark in m.remarks]
    flags += [f"Bare bar, mode {m.number}: {remark}." for m in base for remark in m.remarks]
    notes = (*without_sd(specimen, modes, base), *notes, *unused, *flags)
    return Material(specimen, tuple(values), tuple(conditions(specimen, modes, values)), notes)


class _Draws:
    """Measured values in SI by name: the value itself, then its draws, shape (1 + draws,) each."""

    def __init__(self, specimen: Specimen, rng: np.random.Generator) -> None:
        self.rng = rng
        self.standard = E1876 if specimen.kind == "free-free" else E756
        self.of: dict[str, FloatArray] = {}
        #: names of the values whose standard deviation is not known: what is computed from them has no interval
        self.without_sd: set[str] = set()
        for name, value in specimen.given().items():
            in_si = re.sub("_g$", "_kg", re.sub("_mm$", "_m", name))
            self._note(in_si, value)
            self.of[in_si] = value.draws(rng, TUNING.draws) * (1.0 if in_si == name else 1e-3)

    def _note(self, name: str, value: Quantity) -> None:
        (self.without_sd.add if np.isnan(value.sd) else self.without_sd.discard)(name)

    def add(self, name: str, value: Quantity) -> FloatArray:
        self._note(name, value)
        self.of[name] = value.draws(self.rng, TUNING.draws)
        return self.of[name]

    def some(self, *names: str) -> dict[str, FloatArray]:
        return {name: self.of[name] for name in names}

    def value(
        self, name: str, drawn: FloatArray, sources: Iterable[str], one: BarMode, mode: int | str | None = 0
    ) -> MaterialValue:
        """The row of a value from its draws and the names of what it was computed from; of `one`, or another `mode`."""
        unit, scale = ("GPa", 1e-9) if name[0] in "EG" else ("1", 1.0)
        draws = scale * drawn[1:]
        sources = tuple(sources)
        known = self.without_sd.isdisjoint(sources)
        low, high = np.quantile(draws, INTERVAL_ENDS) if known else (np.nan, np.nan)
        shares = {source: _share(draws, self.of[source][1:]) for source in sources}
        largest = max(shares, key=shares.__getitem__)
        hz = one.frequency_hz
        return MaterialValue(
            mode=one.number if mode == 0 else mode,
            frequency_hz=hz.value,
            frequency_sd_hz=hz.sd,
            quantity=name,
            unit=unit,
            value=scale * float(drawn[0]),
            sd=float(np.std(draws)) if known else np.nan,
            q05=float(low),
            q95=float(high),
            largest_source=re.sub("_(m|kg|kg_m3|hz)$", "", largest) if known and shares[largest] else "",
            share=shares[largest] if known else np.nan,
            equations=self.standard,
            remarks="|".join(one.remarks),
        )

    def loss_factor(self, one: BarMode) -> Iterator[MaterialValue]:
        if one.damping_ratio is not None:
            yield self.value(
                "loss_factor", 2.0 * self.add("damping_ratio", one.damping_ratio), ["damping_ratio"], one
            )


def _share(draws: FloatArray, source: FloatArray) -> float:
    """Squared correlation of two sets of draws; 0 where one does not vary."""
    a, b = draws - np.mean(draws), np.log(source) - np.mean(np.log(source))
    varies = min(np.ptp(draws) / abs(np.mean(draws)), np.ptp(b)) > 1e-12
    return float(np.sum(a * b)) ** 2 / float(np.sum(a * a) * np.sum(b * b)) if varies else 0.0


def _bar(
    made: _Draws, modes: Sequence[BarMode], specimen: Specimen, beam: BeamProperties | None
) -> Iterator[MaterialValue]:
    sizes = made.some("length_m", "thickness_m", "density_kg_m3")
    wrong = {}
    if beam is not None and "width_m" in made.of:
        exact = {name: drawn[:1] for name, drawn in sizes.items()}
        hz = {one.number: np.array([one.frequency_hz.value]) for one in modes}
        wrong = departures(
            beam, specimen, {n: float(equations.bar_modulus(f, n, **exact)[0]) for n, f in hz.items()}
        )
    for one in modes:
        e = equations.bar_modulus(made.add("frequency", one.frequency_hz), one.number, **sizes)
        yield made.value("E", e, [*sizes, "frequency"], one)
        error = wrong.get(one.number, float("nan"))
        if np.isfinite(error):
            yield made.value("E_corrected", e / (1.0 + error), [*sizes, "frequency"], one)
        yield from made.loss_factor(one)


def _layered(
    made: _Draws, modes: Sequence[BarMode], base: Sequence[BarMode], kind: str
) -> Iterator[MaterialValue]:
    of, bare = made.of, {one.number: one for one in base}
    t, d = of["layer_thickness_m"] / of["thickness_m"], of["layer_density_kg_m3"] / of["density_kg_m3"]
    mass_ratio = {"oberst": 1.0 + d * t, "modified-oberst": 1.0 + 2.0 * d * t, "sandwich": 2.0 + d * t}[kind]
    sizes = made.some("length_m", "thickness_m")
    for one in modes:
        if one.number not in bare or one.damping_ratio is None:
            continue
        base_hz = made.add("base_frequency", bare[one.number].frequency_hz)
        e = equations.bar_modulus(base_hz, one.number, density_kg_m3=of["density_kg_m3"], **sizes)
        a = (made.add("frequency", one.frequency_hz) / base_hz) ** 2 * mass_ratio
        eta = 2.0 * made.add("damping_ratio", one.damping_ratio)
        if kind == "sandwich":
            modulus = equations.sandwich_core(
                a, eta, one.number, base_modulus_pa=e, thickness_ratio=t, **sizes
            )
        elif kind == "oberst":
            modulus = equations.oberst_layer(a, eta, base_modulus_pa=e, thickness_ratio=t)
        else:
            modulus = equations.modified_oberst_layer(a, eta, base_modulus_pa=e, thickness_ratio=t)
        sources = [name for name in of if name != "width_m"]
        yield made.value("G1" if kind == "sandwich" else "E1", modulus.real, sources, one)
        yield made.value("loss_factor_1", modulus.imag / modulus.real, sources, one)
        yield made.value("E", e, [*sizes, "density_kg_m3", "base_frequency"], bare[one.number])
        yield made.value("loss_factor", eta, ["damping_ratio"], one)


def _free(made: _Draws, modes: Sequence[BarMode], torsion: Quantity | None) -> Iterator[MaterialValue]:
    sizes = made.some("length_m", "width_m", "thickness_m")
    volume = sizes["length_m"] * sizes["width_m"] * sizes["thickness_m"]
    mass = made.of["mass_kg"] if "mass_kg" in made.of else made.of["density_kg_m3"] * volume
    for one in modes:
        if one.number != 1:
            continue
        hz, sources = made.add("frequency", one.frequency_hz), list(made.of)
        if torsion is None:
            e = equations.free_bar_modulus(hz, made.of["poisson_ratio"], mass_kg=mass, **sizes)
            yield made.value("E", e, sources, one)
        else:
            e, g, mu = equations.free_bar(hz, made.of["torsion_hz"], mass_kg=mass, **sizes)
            yield made.value("E", e, sources, one)
            twisted = BarMode(1, torsion)
            yield made.value("G", g, sources, twisted, "torsion")
            yield made.value("poisson_ratio", mu, sources, one, None)
        yield from made.loss_factor(one)
