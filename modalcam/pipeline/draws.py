"""Posterior draws of an identification and what they come from, in the groups of ArviZ."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from modal_id import DAMPING, FREQUENCY, Identification, IdentifiedMode
from modalcam import __version__
from modalcam.common import shown
from tracker import dataset

if TYPE_CHECKING:
    import xarray

    from modalcam.pipeline.results import RecordingResult

# Samples times channels up to which the series is among the groups: 32 MB.
MOST_OBSERVED = 4_000_000
_DRAWS = ("chain", "draw", "mode")


@dataclass(frozen=True)
class GroupVariable:
    """An array with names of its dimensions; a coordinate has the name of its only dimension."""

    dims: tuple[str, ...]
    values: np.ndarray
    attrs: Mapping[str, Any] = field(default_factory=dict)


def posterior_groups(
    found: Identification, recording: str
) -> dict[str, tuple[dict[str, Any], dict[str, GroupVariable]]]:
    """Attributes and variables of each group; docs/files.md describes them."""
    common = {
        "recording": recording,
        "inference_library": "emcee",
        "creation_library": f"modalcam {__version__}",
    }
    draws = min(mode.posterior.frequency_hz.shape[1] for mode in found.modes)
    coordinates = _coordinates(found.modes, draws)

    def stacked(arrays: list[np.ndarray], **attrs: str) -> GroupVariable:
        values = np.stack([array[:, -draws:] for array in arrays], axis=-1)
        return GroupVariable(_DRAWS, values, {**attrs, "coordinates": "mode_number"})

    posteriors = [mode.posterior for mode in found.modes]
    frequency = {"units": FREQUENCY[0].unit, "long_name": "omega_n / 2 pi"}
    ratio = {"units": DAMPING[0].unit, "long_name": "zeta"}
    groups = {
        "posterior": (
            common,
            {
                **coordinates,
                FREQUENCY[0].name: stacked([p.frequency_hz for p in posteriors], **frequency),
                DAMPING[0].name: stacked([p.damping_ratio for p in posteriors], **ratio),
            },
        )
    }
    sampled = [p.sampled for p in posteriors if p.sampled is not None]
    if len(sampled) == len(posteriors):
        density = [s.log_density for s in sampled]
        as_sampled = "before they are widened by errors of the model and of the frame rate"
        stats = {
            **coordinates,
            "lp": stacked(density, long_name="log density of the draws as sampled, relative to the best fit"),
            f"sampled_{FREQUENCY[0].name}": stacked([s.frequency_hz for s in sampled], **frequency),
            f"sampled_{DAMPING[0].name}": stacked([s.damping_ratio for s in sampled], **ratio),
            "noise_factor": GroupVariable(("mode",), np.array([p.noise_factor for p in posteriors])),
            "noise_dof": GroupVariable(("mode",), np.array([s.noise_dof for s in sampled])),
        }
        groups["sample_stats"] = ({**common, "draws": as_sampled}, stats)
        of_decay = "of all samples at once, for each mode with the others at their best"
        likelihood = {**coordinates, "series": stacked(density, long_name=of_decay)}
        groups["log_likelihood"] = ({**common, "draws": as_sampled}, likelihood)
    observed = _observed(found)
    if observed:
        groups["observed_data"] = (common, observed)
    return groups


def _coordinates(modes: tuple[IdentifiedMode, ...], draws: int) -> dict[str, GroupVariable]:
    numbers = [mode.number or 0 for mode in modes]
    named = all(numbers) and len(set(numbers)) == len(numbers)
    labels = numbers if named else list(range(1, len(modes) + 1))
    return {
        "chain": GroupVariable(("chain",), np.arange(modes[0].posterior.frequency_hz.shape[0])),
        "draw": GroupVariable(("draw",), np.arange(draws)),
        "mode": GroupVariable(("mode",), np.array(labels)),
        "mode_number": GroupVariable(("mode",), np.array(numbers)),
    }


def _observed(found: Identification) -> dict[str, GroupVariable]:
    """Samples that the fit used, NaN where it used none; nothing where they are too many."""
    series, channels, rows = found.series, found.channels_used, found.decay_rows
    values = np.where(found.used, series.values, np.nan)[rows][:, channels]
    if values.size > MOST_OBSERVED:
        return {}
    names = [shown(name) for name, used in zip(series.channels, channels, strict=True) if used]
    return {
        "time": GroupVariable(("time",), series.time_s[rows], {"units": "s"}),
        "channel": GroupVariable(("channel",), np.array(names)),
        "series": GroupVariable(("time", "channel"), values, {"units": series.unit}),
    }


def data_tree(recordings: Iterable[RecordingResult]) -> xarray.DataTree:
    """Tree with a node for each recording in which modes were identified, of the groups of `posterior_groups`."""
    nodes = {"/": dataset()}
    for recording in recordings:
        found = recording.identified
        if found is None or not found.modes:
            continue
        for group, (attrs, given) in posterior_groups(found, recording.name).items():
            arrays = {
                name: (
                    v.dims,
                    v.values,
                    {key: value for key, value in v.attrs.items() if key != "coordinates"},
                )
                for name, v in given.items()
            }
            coordinates = {name for name, v in given.items() if name in v.dims or name == "mode_number"}
            nodes[f"{recording.name}/{group}"] = dataset(arrays, {}, attrs).set_coords(coordinates)
    from xarray import DataTree  # noqa: PLC0415 - optional

    return DataTree.from_dict(nodes)
