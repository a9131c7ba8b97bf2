"""A specimen: its kind, dimensions and modes, each value with its standard deviation, given or those of a run."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, cast, get_args

import numpy as np
from scipy.optimize import newton

from modalcam.apps.deck import damping_of
from modalcam.common import InputError, shown
from modalcam.pipeline import RunResult, load_run
from sim.beam import AncfBeam, BeamProperties, BuckledBeamError, NoEquilibriumError, beam_modes
from tracker import FloatArray, checked

Kind = Literal["bar", "oberst", "modified-oberst", "sandwich", "free-free"]
LAYERED: tuple[Kind, ...] = ("oberst", "modified-oberst", "sandwich")
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_QUANTITY = re.compile(rf"\s*({_NUMBER})\s*(?:(?:\+-|±)\s*({_NUMBER}))?\s*")


@dataclass(frozen=True)
class Quantity:
    """A positive measured value and its standard deviation, NaN where it was not given; ValueError otherwise."""

    value: float
    sd: float = float("nan")

    def __post_init__(self) -> None:
        checked("a measured value", self.value, positive=True)
        if self.sd < 0.0 or np.isinf(self.sd):
            msg = f"a standard deviation must be 0 or positive, got {self.sd}"
            raise ValueError(msg)

    def draws(self, rng: np.random.Generator, count: int) -> FloatArray:
        """The value, then draws with it as their median, shape (1 + count,); a standard deviation of NaN counts as 0.

        Lognormal: a thickness known to 20 % has no negative draw, and its powers have the power of the value as median.
        """
        spread = np.sqrt(np.log1p((np.nan_to_num(self.sd) / self.value) ** 2))
        return np.asarray(self.value * np.exp(spread * np.append(0.0, rng.standard_normal(count))))


def quantity(text: str, name: str) -> Quantity:
    """Read ``VALUE`` or ``VALUE+-SD``; InputError with the option's `name` for anything else."""
    found = _QUANTITY.fullmatch(text)
    value, sd = (float(found[1]), float(found[2] or "nan")) if found else (0.0, 0.0)
    if not 0.0 < value < np.inf or sd < 0.0 or np.isinf(sd):
        msg = f"{name}: expected a positive VALUE or VALUE+-SD, such as 2.03+-0.01; found {shown(text)}"
        raise InputError(msg)
    return Quantity(value, sd)


@dataclass(frozen=True)
class BarMode:
    """A bending mode of a bar: its number from 1, natural frequency, damping ratio if known, and names of flags."""

    number: int
    frequency_hz: Quantity
    damping_ratio: Quantity | None = None
    remarks: tuple[str, ...] = ()


def mode(text: str, name: str) -> BarMode:
    """Read ``NUMBER:HZ[:DAMPING_RATIO]``; InputError with the option's `name` for anything else."""
    number, hz, ratio = (*text.split(":", 2), "", "")[:3]
    if not hz or not re.fullmatch(r"\s*[1-9]\d{0,3}\s*", number):
        msg = f"{name}: expected NUMBER:HZ[:DAMPING_RATIO], such as 2:107.8+-0.1:0.0025; found {shown(text)}"
        raise InputError(msg)
    return BarMode(int(number), quantity(hz, name), quantity(ratio, name) if ratio else None)


@dataclass(frozen=True)
class Specimen:
    """Dimensions and masses of a specimen, named and measured as the options of the command.

    Attributes
    ----------
    kind : str
        ``bar`` (uniform, clamped), ``oberst`` (a damping layer on one side of it), ``modified-oberst`` (equal layers on
        both), ``sandwich`` (a core between two equal bars), or ``free-free`` (uniform, no clamp).
    length_mm, width_mm, thickness_mm, density_kg_m3 : Quantity or None
        Of the bar without its layer, one of the two of a sandwich; the length is the free one.
    mass_g, poisson_ratio, torsion_hz : Quantity or None
        Of a free bar: the mass in place of the density; the assumed ratio, or the first torsional frequency.
    layer_thickness_mm, layer_density_kg_m3 : Quantity or None
        Of one layer, or of the core.

    Raises
    ------
    InputError
        If a value that the equations need is missing, or one that they do not take is given.
    """

    kind: Kind
    length_mm: Quantity | None = None
    width_mm: Quantity | None = None
    thickness_mm: Quantity | None = None
    density_kg_m3: Quantity | None = None
    mass_g: Quantity | None = None
    layer_thickness_mm: Quantity | None = None
    layer_density_kg_m3: Quantity | None = None
    torsion_hz: Quantity | None = None
    poisson_ratio: Quantity | None = None

    def __post_init__(self) -> None:
        expected, found = "", ""
        free, given = self.kind == "free-free", self.given()
        layer = ("layer_thickness_mm", "layer_density_kg_m3") if self.kind in LAYERED else ()
        needed = ("length_mm", "thickness_mm", "width_mm" if free else "density_kg_m3", *layer)
        either = (("mass_g", "density_kg_m3"), ("poisson_ratio", "torsion_hz")) if free else ()
        unused = set(given) - {*needed, "width_mm", *(name for pair in either for name in pair)}
        wrong = next((pair for pair in either if sum(name in given for name in pair) != 1), ())
        if self.kind not in get_args(Kind):
            expected, found = f"one of {', '.join(get_args(Kind))}", shown(self.kind)
        elif not given.keys() >= set(needed):
            expected, found = _options(needed), f"only {_options(given) or 'none'}"
        elif wrong:
            expected, found = f"one of {_options(wrong)}", _options(name for name in wrong if name in given)
        elif unused:
            expected, found = "no other value", _options(sorted(unused))
        if expected:
            msg = f"--specimen {shown(self.kind)}: expected {expected}; found {found or 'neither'}"
            raise InputError(msg)

    def given(self) -> dict[str, Quantity]:
        """The values that are given, by name."""
        values = {name: getattr(self, name) for name in self.__dataclass_fields__ if name != "kind"}
        return {name: value for name, value in values.items() if value is not None}


def _options(names: Iterable[str]) -> str:
    return ", ".join("--" + name.replace("_", "-") for name in names)


def modes_of(result: RunResult) -> tuple[tuple[BarMode, ...], tuple[str, ...]]:
    """Modes of a run with a number and no flag of a wrong value, and sentences on those left out.

    Frequencies are those at small amplitude, damping ratios those at the amplitudes of the recordings; both combined
    over the recordings. InputError without such a mode.
    """
    found = damping_of(result)
    modes = []
    for one in found.modes:
        ratio = Quantity(one.damping_ratio, one.damping_ratio_sd) if one.damping_ratio > 0.0 else None
        modes.append(BarMode(one.number, Quantity(one.frequency_hz, one.frequency_sd_hz), ratio, one.remarks))
    return tuple(modes), tuple(f"Left out: {one}." for one in found.left_out)


def sizes_of(result: RunResult) -> dict[str, Quantity]:
    """Length, width, thickness and density of ``[beam]`` of a run, each with its standard deviation where given."""
    beam = tomllib.loads(result.resolved_config).get("beam", {})
    names = ("length_mm", "width_mm", "thickness_mm", "density_kg_m3")
    return {n: Quantity(beam[n], beam.get(n.replace("_", "_sd_", 1), np.nan)) for n in names if n in beam}


def of_run(result: RunResult) -> dict[str, Any] | None:
    """Arguments of `material` for the beam of a run; None unless a cantilever of one section has numbered modes."""
    if result.beam is None or not (result.beam.standard.cantilever and result.beam.standard.one_section):
        return None
    try:
        modes, notes = modes_of(result)
    except InputError:
        return None
    beam, specimen = result.beam.standard, Specimen("bar", **sizes_of(result))
    return {"specimen": specimen, "modes": modes, "beam": beam, "notes": notes, "seed": result.seed}


_Modes = tuple[Path | None, Sequence[str]]


def request(
    kind: str, sizes: Mapping[str, str | None], of: _Modes, bare: _Modes, plugins: tuple[str, ...] = ()
) -> dict[str, Any]:
    """Arguments of `material` from the words of the command: values, and a run or modes of specimen and bare bar.

    What is not given comes from ``[beam]`` of the bar's run. InputError if both or neither of a run and modes are
    given, or something cannot be read.
    """
    read = {n: quantity(text, f"--{n.replace('_', '-')}") for n, text in sizes.items() if text is not None}
    result, modes, notes = _modes(of, "OUT", "--mode", plugins)
    bar, base = result, tuple[BarMode, ...]()
    if kind in LAYERED:
        bar, base, more = _modes(bare, "--base", "--base-mode", plugins)
        notes = (*notes, *more)
    elif any(bare):
        msg = f"--base and --base-mode: expected only with --specimen {', '.join(LAYERED)}; found {kind}"
        raise InputError(msg)
    beam = bar.beam.standard if bar and bar.beam else None
    if beam and not beam.one_section:
        msg = (
            "[[beam.sections]]: the equations are those of one width and thickness; found changes of section"
        )
        raise InputError(msg)
    if bar and beam:
        sizes_of_run = sizes_of(bar)
        if "mass_g" in read:
            del sizes_of_run["density_kg_m3"]
        read = sizes_of_run | read
    return {
        "specimen": Specimen(cast("Kind", kind), **read),
        "modes": modes,
        "base": base,
        "beam": beam if kind == "bar" else None,
        "notes": notes,
    }


def _modes(
    given: _Modes, run: str, option: str, plugins: tuple[str, ...]
) -> tuple[RunResult | None, tuple[BarMode, ...], tuple[str, ...]]:
    folder, texts = given
    if (folder is None) == (not texts):
        state = "neither" if folder is None else "both"
        msg = f"expected either {run}, a finished run, or {option}; found {state}"
        raise InputError(msg)
    if folder is None:
        return None, tuple(mode(text, option) for text in texts), ()
    result = load_run(folder, plugins)
    return result, *modes_of(result)


def departures(beam: BeamProperties, specimen: Specimen, moduli_pa: dict[int, float]) -> dict[int, float]:
    """Relative error of the modulus of each mode by what the equations leave out: gravity, point masses, elastic clamp.

    The beam with these has, at the modulus sought, the frequency that one without them has at the modulus found; both
    are computed on one mesh with the dimensions of the specimen. NaN for a standing beam that would buckle; nothing of
    modes that the mesh does not have.
    """
    sizes = {name: value.value for name, value in specimen.given().items()}
    bare = BeamProperties.uniform(
        length_m=1e-3 * sizes["length_mm"],
        width_m=1e-3 * sizes["width_mm"],
        thickness_m=1e-3 * sizes["thickness_mm"],
        density_kg_m3=sizes["density_kg_m3"],
        elastic_modulus_pa=1.0,
        orientation="none",
        elements=beam.elements,
    )
    names = ("orientation", "point_masses", "gravity_m_s2", "angle_deg", "clamp", "ends", "tension_n")
    full = replace(bare, **{name: getattr(beam, name) for name in names})
    of_mesh = {n: e for n, e in moduli_pa.items() if n <= 2 * beam.elements}
    slope = beam_modes(AncfBeam(bare), max(of_mesh, default=1)).omega_rad_s ** 2
    return {n: _departure(full, n, e, float(slope[n - 1])) for n, e in of_mesh.items()}


def _departure(beam: BeamProperties, number: int, modulus_pa: float, slope: float) -> float:
    """Of one mode; `slope` is the squared frequency of the beam without bodies at 1 Pa."""

    def excess(e: float) -> float:
        modes = beam_modes(AncfBeam(replace(beam, elastic_modulus_pa=e)), number)
        return float(modes.omega_rad_s[number - 1]) ** 2 / slope - modulus_pa

    try:
        # Affine in the modulus but for the shape's dependence on it: three steps of the secant.
        found = newton(excess, modulus_pa, x1=1.01 * modulus_pa, rtol=1e-9)
    except (BuckledBeamError, NoEquilibriumError, RuntimeError):
        return float("nan")
    return modulus_pa / float(found) - 1.0
