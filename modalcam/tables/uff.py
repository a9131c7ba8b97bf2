"""Universal files (UFF) in ASCII: series and responses as dataset 58, shapes 55, nodes 15, units 164, a header 151.

A universal file cannot hold missing samples: a channel with gaps is written without them, on uneven abscissae.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from modal_id import FrequencyResponse, Identification, IdentifiedMode
from modal_id.solve import pole
from modalcam import __version__
from modalcam.config import ExperimentConfig
from modalcam.pipeline import RunResult, Workspace, replacing
from modalcam.tables.base import Output, Writer
from tracker import DisplacementSeries, FloatArray

_TIME_AXIS = 17
# Dimension of the ordinate in powers of length; time is always in seconds.
_LENGTH_EXPONENT = 1
_COMPLEX_MODE, _TRANSLATIONS, _STRUCTURAL = 3, 2, 1
_DISPLACEMENT = 8
_FREQUENCY_AXIS, _FORCE = 18, 13
# Types of a function.
_FRF, _TRANSMISSIBILITY = 4, 5
# Times are written one by one if start and increment, as written, miss one by more than this share of a step.
_EVEN = 1e-4
# Values are divided by these factors for SI units.
_MILLIMETRES = {
    "units_code": 9,
    "units_description": "mm, N, K",
    "temp_mode": 1,
    "length": 1e3,
    "force": 1.0,
    "temp": 1.0,
    "temp_offset": 0.0,
}


def write_uff(path: Path, found: Identification) -> None:
    """Write a header (dataset 151), the shapes of modes (55) and their nodes (15), and the channels of the series (58).

    The header has no dates: the same results give the same bytes.

    Nodes number the channels from 1; the direction of response is the image axis along which the markers move (1: x,
    2: y), or 0 (scalar) if they move along neither. Shapes are complex eigenvectors of first order, translations in x,
    y, z at `Onset.fit_from_s`, with the eigenvalue ``lambda``; channels without any sample are omitted. Nodes lie on a
    line across the direction of motion, in mm from the clamp (164); they are omitted where positions are unknown.
    """
    import pyuff  # noqa: PLC0415 - optional

    sets = [pyuff.prepare_55(**_shape(found, mode, index)) for index, mode in enumerate(found.modes)]
    if sets and np.isfinite(found.series.positions_mm).all():
        sets = [pyuff.prepare_164(**_MILLIMETRES), pyuff.prepare_15(**_nodes(found.series)), *sets]
    with replacing(path) as temporary:
        # Not by pyuff: it writes the time of writing.
        temporary.write_text("".join(f"{line}\n" for line in _header(found)), encoding="ascii", newline="\n")
        if sets:
            # Before the channels: before each set, pyuff reads all that the file holds.
            pyuff.UFF(str(temporary)).write_sets(sets, "add")
        # Not by pyuff: its abscissae have six digits, too few for frequencies.
        with temporary.open("a", encoding="ascii", newline="\n") as file:
            for k in range(len(found.series.channels)):
                file.writelines(f"{line}\n" for line in _function(found.series, k))
            if found.response is not None:
                for k in range(len(found.response.channels)):
                    file.writelines(f"{line}\n" for line in _response(found.series, found.response, k))


def _header(found: Identification) -> Iterator[str]:
    """Lines of dataset 151: name, description, program; dates are blank, the file is a universal one (0)."""
    program = _text(f"modalcam {__version__}", 80)
    yield f"{-1:6d}"
    yield f"{151:6d}"
    yield _text(found.series.name, 80)
    yield _text(f"{len(found.series.channels)} channels in {found.series.unit}, {len(found.modes)} modes", 80)
    yield program
    yield f"{'':20s}{0:10d}{0:10d}{0:10d}"
    yield f"{'':20s}"
    yield program
    yield f"{'':20s}"
    yield f"{-1:6d}"


def _function(series: DisplacementSeries, k: int) -> Iterator[str]:
    """Lines of dataset 58 of a channel; none where it has fewer than two samples."""
    seen = np.isfinite(series.values[:, k])
    time_s, values = series.time_s[seen], series.values[seen, k]
    if time_s.size < 2:
        return
    even, position = _is_even(time_s), series.positions_mm[k]
    step = time_s[1] - time_s[0]
    entity = _text(series.channels[k], 10)
    axis = (_real13(time_s[0]), _real13(step)) if even else (_real13(0.0), _real13(0.0))
    yield from (
        f"{-1:6d}",
        f"{58:6d}",
        _text(f"{series.channels[k]} of {series.name}", 80),
        _text(f"displacement in {series.unit} along the direction of motion", 80),
        "NONE",
        f"{position:g} mm from the clamp" if np.isfinite(position) else "NONE",
        "NONE",
        f"{1:5d}{k + 1:10d}{0:5d}{0:10d} {entity:<10s}{k + 1:10d}{_direction(series):4d} {'NONE':<10s}{0:10d}{0:4d}",
        f"{4:10d}{values.size:10d}{int(even):10d}{axis[0]}{axis[1]}{_real13(0.0)}",
        _axis(_TIME_AXIS, 0, "Time", "s"),
        _axis(_DISPLACEMENT, _LENGTH_EXPONENT, "Displacement", _text(series.unit, 20)),
        _axis(0, 0, "NONE", "NONE"),
        _axis(0, 0, "NONE", "NONE"),
    )
    if even:
        yield from ("".join(f"{v:20.12E}" for v in values[row : row + 4]) for row in range(0, values.size, 4))
    else:
        pairs = (f"{_real13(t)}{v:20.12E}" for t, v in zip(time_s, values, strict=True))
        yield from ("".join(line) for line in zip_longest(pairs, pairs, fillvalue=""))
    yield f"{-1:6d}"


def _response(series: DisplacementSeries, response: FrequencyResponse, k: int) -> Iterator[str]:
    """Lines of dataset 58 of the response of the fitted modes at a channel: complex, at uneven frequencies."""
    known = series.known_input
    is_force = known is not None and known.is_force
    name, values = response.channels[k], response.model[:, k]
    node = series.channels.index(name) + 1
    direction, entity = _direction(series), _text(response.input_name, 10)
    kind = _FRF if is_force else _TRANSMISSIBILITY
    yield from (
        f"{-1:6d}",
        f"{58:6d}",
        _text(f"response of {name} to {response.input_name}, {series.name}", 80),
        _text(f"of the fitted modes; unit {response.unit}", 80),
        "NONE",
        "NONE",
        "NONE",
        f"{kind:5d}{node:10d}{0:5d}{0:10d} {_text(name, 10):<10s}{node:10d}{direction:4d} {entity:<10s}{0:10d}{0:4d}",
        f"{6:10d}{values.size:10d}{0:10d}{_real13(0.0)}{_real13(0.0)}{_real13(0.0)}",
        _axis(_FREQUENCY_AXIS, 0, "Frequency", "Hz"),
        _axis(_DISPLACEMENT, _LENGTH_EXPONENT, "Displacement", _text(series.unit, 20)),
        _axis(
            _FORCE if is_force else _DISPLACEMENT,
            0 if is_force else _LENGTH_EXPONENT,
            "Input",
            "NONE" if known is None else _text(known.unit, 20),
        ),
        _axis(0, 0, "NONE", "NONE"),
    )
    pairs = zip(response.frequency_hz, values, strict=True)
    yield from (f"{_real13(hz)}{value.real:20.12E}{value.imag:20.12E}" for hz, value in pairs)
    yield f"{-1:6d}"


def _axis(kind: int, length_exponent: int, label: str, unit: str) -> str:
    return f"{kind:10d}{length_exponent:5d}{0:5d}{0:5d} {label:<20s} {unit:<20s}"


def _real13(value: float) -> str:
    """A real in the 13 columns of format E13.5 with all digits that fit; an explicit decimal point takes precedence."""
    texts = [f"{value:.{d}f}" for d in range(10, 0, -1)] + [f"{value:.{d}E}" for d in range(6, 0, -1)]
    fitting = [text for text in texts if len(text) <= 12]
    return f"{min(fitting, key=lambda text: abs(float(text) - value)):>13s}"


def _text(text: str, longest: int) -> str:
    """One line of ASCII, cut to the length of its field."""
    plain = text.encode("ascii", "replace").decode("ascii")
    return "".join(c if c.isprintable() else "?" for c in plain)[:longest] or "NONE"


def _direction(series: DisplacementSeries) -> int:
    x, y = series.direction
    if abs(y) < 1e-2 and abs(x) > 0.5:
        return 1 if x > 0.0 else -1
    if abs(x) < 1e-2 and abs(y) > 0.5:
        return 2 if y > 0.0 else -2
    return 0


def _is_even(time_s: FloatArray) -> bool:
    step = time_s[1] - time_s[0]
    again = float(_real13(time_s[0])) + float(_real13(step)) * np.arange(time_s.size)
    return bool(np.all(np.abs(again - time_s) <= _EVEN * step))


def _nodes(series: DisplacementSeries) -> dict[str, Any]:
    x, y = _in_plane(series)
    count = len(series.channels)
    return {
        "node_nums": list(range(1, count + 1)),
        "def_cs": [0] * count,
        "disp_cs": [0] * count,
        "color": [1] * count,
        "x": series.positions_mm * y,
        "y": series.positions_mm * -x,
        "z": np.zeros(count),
    }


def _in_plane(series: DisplacementSeries) -> tuple[float, float]:
    """Direction of motion in the image, along x where it is unknown."""
    x, y = series.direction
    return (x, y) if np.isfinite(x) and np.isfinite(y) else (1.0, 0.0)


def _shape(found: Identification, mode: IdentifiedMode, index: int) -> dict[str, Any]:
    seen = np.flatnonzero(np.isfinite(mode.shape))
    x, y = _in_plane(found.series)
    shape = mode.shape[seen]
    begin_s = found.onset.fit_from_s if mode.other_from_s is None else mode.other_from_s
    eigenvalue = complex(pole(mode.omega_n_rad_s, mode.damping_ratio))
    return {
        "id1": _text(found.series.name, 80),
        "id2": f"{mode.frequency_hz:.9g} Hz, sd {mode.frequency_sd_hz:.3g} Hz"[:80],
        "id3": f"damping ratio {mode.damping_ratio:.9g}, sd {mode.damping_ratio_sd:.3g}"[:80],
        "id4": f"amplitudes in {_text(mode.amplitude_unit, 20)} at {begin_s:.6f} s",
        "model_type": _STRUCTURAL,
        "analysis_type": _COMPLEX_MODE,
        "data_ch": _TRANSLATIONS,
        "spec_data_type": _DISPLACEMENT,
        "data_type": 5,
        "n_data_per_node": 3,
        "r1": x * shape,
        "r2": y * shape,
        "r3": np.zeros(shape.size, dtype=complex),
        "load_case": 0,
        "mode_n": mode.number or index + 1,
        "eig": eigenvalue,
        "modal_a": 0.0 + 0.0j,
        "modal_b": 0.0 + 0.0j,
        "node_nums": [int(k) + 1 for k in seen],
    }


def _outputs(workspace: Workspace, result: RunResult, _: ExperimentConfig) -> Iterator[Output]:
    for recording in result.recordings:
        found = recording.identification
        if isinstance(found, Identification):
            yield Output(workspace.universal(recording.name), found, partial(write_uff, found=found))


UNIVERSAL = Writer(
    "universal",
    "universal/<recording>.uff",
    "universal file in ASCII: a header (dataset 151), the series (dataset 58, one per marker, missing samples omitted) "
    "and the complex mode shapes (dataset 55, analysis type 3, six digits) on their nodes (datasets 15 and 164); "
    "with a measured input, the responses (dataset 58, function type 4 for a force, 5 for a base)",
    _outputs,
    libraries=("pyuff",),
)
