"""Posterior draws as NetCDF in the layout that ArviZ opens: group ``posterior``, dimensions chain and draw."""

from __future__ import annotations

import os
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from modal_id.results import Identification, IdentifiedMode
from modalcam import __version__
from modalcam.config.schema import ExperimentConfig
from modalcam.export.base import Output, Writer
from modalcam.pipeline.results import RunResult
from modalcam.storage.atomic import replacing
from modalcam.storage.output_folder import Workspace

# Of a file beside its arrays, at most.
_OVERHEAD_BYTES = 100_000


def write_posterior(path: Path, modes: tuple[IdentifiedMode, ...], recording: str) -> None:
    """Write the draws of all modes of a recording; a chain is an independent ensemble of emcee.

    Variables ``frequency_hz`` and ``damping_ratio`` have dimensions (chain, draw, mode). The coordinate ``mode`` is the
    number of the beam's mode if all modes have one, otherwise the rank by frequency from 1; ``mode_number`` is the
    number of the beam's mode, 0 if unknown. If modes have different numbers of draws, the last ones of each are kept.
    """
    import xarray as xr  # noqa: PLC0415 - optional

    draws = min(mode.posterior.frequency_hz.shape[1] for mode in modes)
    chains = modes[0].posterior.frequency_hz.shape[0]

    def stacked(name: str) -> np.ndarray:
        return np.stack([getattr(mode.posterior, name)[:, -draws:] for mode in modes], axis=-1)

    numbers = [mode.number or 0 for mode in modes]
    labels = numbers if all(numbers) and len(set(numbers)) == len(numbers) else list(range(1, len(modes) + 1))
    dims = ("chain", "draw", "mode")
    data = xr.Dataset(
        {
            "frequency_hz": (dims, stacked("frequency_hz"), {"units": "Hz", "long_name": "omega_n / 2 pi"}),
            "damping_ratio": (dims, stacked("damping_ratio"), {"units": "1", "long_name": "zeta"}),
        },
        coords={
            "chain": np.arange(chains),
            "draw": np.arange(draws),
            "mode": labels,
            "mode_number": ("mode", numbers),
        },
        attrs={
            "recording": recording,
            "inference_library": "emcee",
            "creation_library": f"modalcam {__version__}",
        },
    )
    with replacing(path) as temporary:
        # On a full medium HDF5 ends the process: as much space as the file needs must be free.
        with temporary.open("wb") as file:
            file.write(bytes(int(1.1 * data.nbytes) + _OVERHEAD_BYTES))
            file.flush()
            os.fsync(file.fileno())
        data.to_netcdf(temporary, group="posterior", engine="h5netcdf")


def _outputs(workspace: Workspace, result: RunResult, _: ExperimentConfig) -> Iterator[Output]:
    for recording in result.recordings:
        found, name = recording.identification, recording.name
        if isinstance(found, Identification) and found.modes:
            write = partial(write_posterior, modes=found.modes, recording=name)
            yield Output(workspace.posterior(name), (found.modes, name), write)


POSTERIOR = Writer(
    "posterior",
    "posterior/<recording>.nc",
    "draws of the posterior: `arviz.from_netcdf` opens it; `mode` is the number of the beam's mode if all modes have "
    "one, otherwise the rank by frequency",
    _outputs,
    libraries=("xarray", "h5netcdf"),
    extra="netcdf",
)
