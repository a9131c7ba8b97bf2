"""Damping models that are compared with a recording, each with draws of what it was built from."""

from __future__ import annotations

from dataclasses import dataclass

from sim.damping import DampingModel


@dataclass(frozen=True)
class Candidate:
    """A damping model and draws of it.

    Attributes
    ----------
    model : DampingModel
    draws : tuple of DampingModel
        The same model built from draws of the posterior of all modes that it rests on; empty for no band. A model that
        is expensive to simulate may have fewer than the others, every second or every fourth of theirs.
    """

    model: DampingModel
    draws: tuple[DampingModel, ...] = ()
