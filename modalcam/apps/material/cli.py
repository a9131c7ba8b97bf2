"""``modalcam material``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from modalcam.cli import Replace, Seed, register_command, results_console, takes
from modalcam.common import check_new, shown


def _measured(text: str) -> Any:
    return typer.Option(metavar="VALUE+-SD", help=text)


@takes("plugins")
def material(
    common: dict[str, Any],
    source: Annotated[
        Path | None, typer.Argument(metavar="OUT", help="Folder of a finished run; or give --mode.")
    ] = None,
    specimen: Annotated[
        str, typer.Option(metavar="KIND", help="bar, oberst, modified-oberst, sandwich, free-free.")
    ] = "bar",
    mode: Annotated[
        list[str] | None,
        typer.Option(metavar="N:HZ:ZETA", help="Mode, damping ratio optional; may be repeated."),
    ] = None,
    base: Annotated[Path | None, typer.Option(metavar="OUT", help="Run of the bar without layer.")] = None,
    base_mode: Annotated[
        list[str] | None, typer.Option(metavar="N:HZ", help="Mode of the bar without layer; may be repeated.")
    ] = None,
    length_mm: Annotated[str | None, _measured("Free length; default: of the run.")] = None,
    width_mm: Annotated[str | None, _measured("Width; default: of the run.")] = None,
    thickness_mm: Annotated[str | None, _measured("Thickness of the bar; default: of the run.")] = None,
    density_kg_m3: Annotated[str | None, _measured("Density of the bar; default: of the run.")] = None,
    mass_g: Annotated[str | None, _measured("Mass of a free bar, in place of its density.")] = None,
    layer_thickness_mm: Annotated[str | None, _measured("Thickness of the layer or core.")] = None,
    layer_density_kg_m3: Annotated[str | None, _measured("Density of the layer or core.")] = None,
    torsion_hz: Annotated[str | None, _measured("Torsional mode of a free bar.")] = None,
    poisson_ratio: Annotated[str | None, _measured("Assumed, without torsion.")] = None,
    out: Annotated[Path | None, typer.Option("-o", "--out", help="CSV file to write.")] = None,
    seed: Seed = 0,
    force: Replace = False,
) -> None:
    """Compute moduli and loss factors of the material."""
    from modalcam.apps.material.material import material as computed
    from modalcam.apps.material.page import show, write_csv
    from modalcam.apps.material.specimen import request

    if out is not None:
        check_new(out, force=force)
    sizes = {
        "length_mm": length_mm, "width_mm": width_mm, "thickness_mm": thickness_mm, "density_kg_m3": density_kg_m3,
        "mass_g": mass_g, "layer_thickness_mm": layer_thickness_mm, "layer_density_kg_m3": layer_density_kg_m3,
        "torsion_hz": torsion_hz, "poisson_ratio": poisson_ratio,
    }  # fmt: skip
    runs = ((source, mode or ()), (base, base_mode or ()))
    found = computed(**request(specimen, sizes, *runs, tuple(common["plugins"] or ())), seed=seed)
    show(found, results_console(None if sys.stdout.isatty() else 120))
    if out is not None:
        write_csv(found, out)
        typer.echo(shown(str(out)))


register_command(material)
