"""A specimen: its kind, dimensions and modes, each value with its standard deviation."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from modalcam.common import InputError, shown
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
