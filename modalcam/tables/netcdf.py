"""Posterior draws and what they come from as NetCDF, in the groups that ArviZ opens."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from modal_id import DAMPING, FREQUENCY, Identification, IdentifiedMode
from modalcam import __version__
from modalcam.common import shown
from modalcam.config import ExperimentConfig
from modalcam.pipeline import RunResult, Workspace, replacing
from modalcam.tables.base import Output, Writer

# Of a file beside its arrays, at most, and of each of its variables.
_OVERHEAD_BYTES = 100_000
_VARIABLE_BYTES = 10_000
# Samples times channels up to which the series is in the file: 32 MB.
MOST_OBSERVED = 4_000_000
_DRAWS = ("chain", "draw", "mode")


@dataclass(frozen=True)
class _Variable:
    """An array with names of its dimensions; a coordinate has the name of its only dimension."""

    dims: tuple[str, ...]
    values: np.ndarray
    attrs: Mapping[str, Any] = field(default_factory=dict)


def write_posterior(path: Path, found: Identification, recording: str) -> None:
    """Write draws, log-likelihood, sampler's density and data of a recording; a chain is an ensemble of emcee.

    Group ``posterior``: ``frequency_hz`` and ``damping_ratio`` with dimensions (chain, draw, mode). The coordinate
    ``mode`` is the number of the beam's mode if all modes have one, otherwise the rank by frequency from 1;
    ``mode_number`` is the number of the beam's mode, 0 if unknown. If modes have different numbers of draws, the last
    ones of each are kept. Groups ``sample_stats`` and ``log_likelihood``: of the draws as sampled, see `SampledDraws`.
    Group ``observed_data``: the samples that the fit used, unless there are more than `MOST_OBSERVED`.
    """
    import h5netcdf  # noqa: PLC0415 - optional

    groups = _groups(found, recording)
    variables = [variable for _, given in groups.values() for variable in given.values()]
    size = sum(v.values.nbytes for v in variables) + _VARIABLE_BYTES * len(variables) + _OVERHEAD_BYTES
    with replacing(path) as temporary:
        # On a full medium HDF5 ends the process: as much space as the file needs must be free.
        with temporary.open("wb") as file:
            file.write(bytes(int(1.1 * size)))
            file.flush()
            os.fsync(file.fileno())
        with h5netcdf.File(temporary, "w") as made:
            for name, (attrs, given) in groups.items():
                group = made.create_group(name)
                group.attrs.update(attrs)
                for dim, size in {d: n for v in given.values() for d, n in _sizes(v)}.items():
                    group.dimensions[dim] = size
                for key, variable in given.items():
                    written = group.create_variable(key, variable.dims, data=variable.values)
                    written.attrs.update(variable.attrs)


def _sizes(variable: _Variable) -> Iterator[tuple[str, int]]:
    return zip(variable.dims, variable.values.shape, strict=True)


def _groups(found: Identification, recording: str) -> dict[str, tuple[dict[str, Any], dict[str, _Variable]]]:
    """Attributes and variables of each group."""
    common = {
        "recording": recording,
        "inference_library": "emcee",
        "creation_library": f"modalcam {__version__}",
    }
    draws = min(mode.posterior.frequency_hz.shape[1] for mode in found.modes)
    coordinates = _coordinates(found.modes, draws)

    def stacked(arrays: list[np.ndarray], **attrs: str) -> _Variable:
        values = np.stack([array[:, -draws:] for array in arrays], axis=-1)
        return _Variable(_DRAWS, values, {**attrs, "coordinates": "mode_number"})

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
            "noise_factor": _Variable(("mode",), np.array([p.noise_factor for p in posteriors])),
            "noise_dof": _Variable(("mode",), np.array([s.noise_dof for s in sampled])),
        }
        groups["sample_stats"] = ({**common, "draws": as_sampled}, stats)
        of_decay = "of all samples at once, for each mode with the others at their best"
        likelihood = {**coordinates, "series": stacked(density, long_name=of_decay)}
        groups["log_likelihood"] = ({**common, "draws": as_sampled}, likelihood)
    observed = _observed(found)
    if observed:
        groups["observed_data"] = (common, observed)
    return groups


def _coordinates(modes: tuple[IdentifiedMode, ...], draws: int) -> dict[str, _Variable]:
    numbers = [mode.number or 0 for mode in modes]
    named = all(numbers) and len(set(numbers)) == len(numbers)
    labels = numbers if named else list(range(1, len(modes) + 1))
    return {
        "chain": _Variable(("chain",), np.arange(modes[0].posterior.frequency_hz.shape[0])),
        "draw": _Variable(("draw",), np.arange(draws)),
        "mode": _Variable(("mode",), np.array(labels)),
        "mode_number": _Variable(("mode",), np.array(numbers)),
    }


def _observed(found: Identification) -> dict[str, _Variable]:
    """Samples that the fit used, NaN where it used none; nothing where they are too many."""
    series, channels, rows = found.series, found.channels_used, found.decay_rows
    values = np.where(found.used, series.values, np.nan)[rows][:, channels]
    if values.size > MOST_OBSERVED:
        return {}
    names = [shown(name) for name, used in zip(series.channels, channels, strict=True) if used]
    return {
        "time": _Variable(("time",), series.time_s[rows], {"units": "s"}),
        "channel": _Variable(("channel",), np.char.encode(names, "utf-8"), {"_Encoding": "utf-8"}),
        "series": _Variable(("time", "channel"), values, {"units": series.unit}),
    }


def _outputs(workspace: Workspace, result: RunResult, _: ExperimentConfig) -> Iterator[Output]:
    for recording in result.recordings:
        found, name = recording.identification, recording.name
        if isinstance(found, Identification) and found.modes:
            yield Output(
                workspace.posterior(name), found, partial(write_posterior, found=found, recording=name)
            )


POSTERIOR = Writer(
    "posterior",
    "posterior/<recording>.nc",
    "draws of the posterior, their log-likelihood and the samples fitted: `arviz.from_netcdf` opens it; `mode` is the "
    "number of the beam's mode if all modes have one, otherwise the rank by frequency",
    _outputs,
    libraries=("h5netcdf",),
    extra="netcdf",
)
