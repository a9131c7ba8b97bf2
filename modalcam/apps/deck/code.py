"""A simulation code that a deck is written for, and what its lines are made of."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from modalcam.apps.deck.damping import DampedMode, Damping
from sim.damping import RayleighDamping

_WIDTH = 72
# Of names and sentences: no code takes one of these for the end of a comment or a continued line.
_UNSAFE = re.compile(r"[^A-Za-z0-9 .,:;()/+=%<>'*_-]")


@dataclass(frozen=True)
class Code:
    """A simulation code.

    Attributes
    ----------
    name : str
        As ``--code`` names it.
    title : str
        As its makers write it.
    comment : str
        What a line of comment begins with.
    notes : tuple of str
        What its user must know: where the lines belong, what is added to them, what happens to other modes.
    modal : callable
        Lines with the damping ratio of each mode.
    rayleigh : callable
        Lines with alpha (1/s, on the mass) and beta (s, on the stiffness), for analyses without modes.
    """

    name: str
    title: str
    comment: str
    notes: tuple[str, ...]
    modal: Callable[[Damping], Iterable[str]]
    rayleigh: Callable[[RayleighDamping], Iterable[str]]

    def text(self, damping: Damping) -> str:
        """The deck: comments, the modal lines, and the Rayleigh lines as comments."""
        between = ", ".join(map(str, damping.between))
        said = [
            f"Damping for {self.title}.",
            *damping.provenance,
            *(f"Left out: {reason}." for reason in damping.left_out),
            _NUMBERS,
            *self.notes,
            *(
                [f"Not measured: mode {between}. Where modes are counted, its ratio is interpolated."]
                if between
                else []
            ),
            *(line for mode in damping.modes for line in _measured(mode)),
        ]
        lines = [*self._comments(said), *self.modal(damping), *self._alternative(damping)]
        return "".join(f"{line}\n" for line in lines)

    def _alternative(self, damping: Damping) -> Iterator[str]:
        found = damping.rayleigh
        if found is None:
            yield from self._comments(["Rayleigh damping needs two measured modes."])
            return
        omega = 2.0 * np.pi * np.array([mode.frequency_hz for mode in damping.modes])
        shares = found.damping_ratio(omega) / [mode.damping_ratio for mode in damping.modes]
        misfit = (f"{100.0 * s:.1f} % in mode {m.number}" for m, s in zip(damping.modes, shares, strict=True))
        sentence = (
            f"Rayleigh damping, in place of the lines above and not with them: alpha {real(found.alpha_1_s)} 1/s, beta "
            f"{real(found.beta_s)} s, least squares over all modes. Of the measured ratio it gives {', '.join(misfit)}."
        )
        yield from self._comments([sentence])
        yield from (f"{self.comment} {line}" for line in self.rayleigh(found))

    def _comments(self, sentences: Iterable[str]) -> Iterator[str]:
        for sentence in sentences:
            for line in textwrap.wrap(_UNSAFE.sub("_", sentence), _WIDTH):
                yield f"{self.comment} {line}"


_NUMBERS = (
    "Mode numbers count the bending modes in the filmed plane. A model also has modes across it, of torsion and along "
    "the axis: compare frequencies before you use a number."
)


def _measured(mode: DampedMode) -> Iterator[str]:
    yield (
        f"mode {mode.number}: {mode.frequency_hz:.6g} Hz, damping ratio {mode.damping_ratio:.5g}, 90 % interval "
        f"{mode.low:.5g} to {mode.high:.5g}"
    )
    yield from mode.remarks


def real(value: float) -> str:
    """A number with six significant digits and a decimal point or an exponent, as all of these codes read it."""
    return repr(float(f"{value:.6g}"))


def fill(words: Iterable[str], count: int) -> Iterator[tuple[str, ...]]:
    """Groups of at most `count` words."""
    rest = tuple(words)
    while rest:
        yield rest[:count]
        rest = rest[count:]
