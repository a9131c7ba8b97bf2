"""Damping models as the report shows them: names, colours and symbols of their registry."""

from __future__ import annotations

from sim.damping import DAMPING_MODELS

# Colour of a model that is not registered.
_UNKNOWN = "#a8326e"


def model_name(model: str) -> str:
    """Name of a damping model in the middle of a sentence."""
    entry = DAMPING_MODELS.get(model)
    return f"{model} damping" if entry is None else entry.name


def model_label(model: str) -> str:
    """Name of a damping model at the start of a line."""
    name = model_name(model)
    return name[0].upper() + name[1:]


def model_colour(model: str) -> str:
    """Colour of a damping model in every figure."""
    entry = DAMPING_MODELS.get(model)
    return _UNKNOWN if entry is None else entry.colour


def model_marker(model: str) -> str:
    """Marker of a damping model in every figure."""
    entry = DAMPING_MODELS.get(model)
    return "D" if entry is None else entry.marker


def model_line_style(model: str) -> str:
    """Line style of a damping model in a figure of several."""
    entry = DAMPING_MODELS.get(model)
    return ":" if entry is None else entry.line_style


def is_variant(model: str) -> bool:
    """Whether a damping model differs from another one at large amplitude only."""
    entry = DAMPING_MODELS.get(model)
    return entry is not None and entry.variant_of is not None


def colour_variables() -> dict[str, str]:
    """Variable of the style sheet for the colour of each damping model."""
    return {entry.colour: f"--damping-{key}" for key, entry in DAMPING_MODELS.items()}


def damping_style() -> str:
    """Rules of the style sheet for the damping models: a colour for each, on a light and on a dark page."""
    entries = DAMPING_MODELS.values()
    light = " ".join(f"--damping-{entry.key}: {entry.colour};" for entry in entries)
    dark = " ".join(f"--damping-{entry.key}: {entry.dark_colour};" for entry in entries)
    cells = "\n".join(f"td.{entry.key} {{ color: var(--damping-{entry.key}); }}" for entry in entries)
    return f":root {{ {light} }}\n@media screen and (prefers-color-scheme: dark) {{ :root {{ {dark} }} }}\n{cells}\n"
