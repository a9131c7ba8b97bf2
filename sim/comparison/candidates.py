"""Damping models that are compared with a recording, each with posterior draws."""

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
        The same model built from posterior draws of the modes that it depends on; empty for no band. A model that is
        slow to simulate may have fewer than the others, every second or every fourth of theirs.
    """

    model: DampingModel
    draws: tuple[DampingModel, ...] = ()
