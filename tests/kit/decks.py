"""Decks of the paper's damping: the modes, the lines that a code reads, and those of Rayleigh damping."""

from modalcam.apps.deck import CODES, DampedMode, Damping
from sim import MEASURED_DAMPING_RATIO, MEASURED_FREQUENCY_HZ


def paper_damping(numbers=(1, 2, 3, 4, 5)):
    """The paper's modes, given these numbers, with intervals of 2 %."""
    found = zip(numbers, MEASURED_FREQUENCY_HZ, MEASURED_DAMPING_RATIO, strict=True)
    return Damping(tuple(DampedMode(n, hz, ratio, 0.98 * ratio, 1.02 * ratio) for n, hz, ratio in found))


def read_by_the_code(text, name):
    """Lines that are no comments."""
    return [line for line in text.splitlines() if not line.startswith(CODES[name].comment)]


def rayleigh_lines(text, name):
    """The commented lines after the last sentence, whose end is the misfit of the highest mode."""
    head, _, tail = text.rpartition(" mode ")
    assert "Rayleigh damping" in head
    return [line.removeprefix(CODES[name].comment + " ") for line in tail.splitlines()[1:]]
