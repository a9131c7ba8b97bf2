"""Posterior draws and what they come from as NetCDF, in the groups that ArviZ opens."""

from __future__ import annotations

import os
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from modal_id import Identification
from modalcam.config import ExperimentConfig
from modalcam.pipeline import GroupVariable, RunResult, Workspace, posterior_groups, replacing
from modalcam.tables.base import Output, Writer

# Of a file beside its arrays, at most, and of each of its variables.
_OVERHEAD_BYTES = 100_000
_VARIABLE_BYTES = 10_000


def write_posterior(path: Path, found: Identification, recording: str) -> None:
    """Write draws, log-likelihood, sampler's density and data of a recording; a chain is an ensemble of emcee.

    Group ``posterior``: ``frequency_hz`` and ``damping_ratio`` with dimensions (chain, draw, mode). The coordinate
    ``mode`` is the number of the beam's mode if all modes have one, otherwise the rank by frequency from 1;
    ``mode_number`` is the number of the beam's mode, 0 if unknown. If modes have different numbers of draws, the last
    ones of each are kept. Groups ``sample_stats`` and ``log_likelihood``: of the draws as sampled, see `SampledDraws`.
    Group ``observed_data``: the samples that the fit used, unless there are more than four million.
    """
    import h5netcdf  # noqa: PLC0415 - optional

    groups = posterior_groups(found, recording)
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
                    is_text = variable.values.dtype.kind == "U"
                    values = np.char.encode(variable.values, "utf-8") if is_text else variable.values
                    written = group.create_variable(key, variable.dims, data=values)
                    written.attrs.update({**variable.attrs, **({"_Encoding": "utf-8"} if is_text else {})})


def _sizes(variable: GroupVariable) -> Iterator[tuple[str, int]]:
    return zip(variable.dims, variable.values.shape, strict=True)


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
)
