"""``modalcam render``, ``demo`` and ``preview``: footage of a simulated beam, and of a line in an identified mode."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from modalcam.cli import Replace, Seed, Verbose, compute, console, register_command, run_options, takes
from modalcam.common import InputError, ModalcamError, check_new, shown

if TYPE_CHECKING:
    from modalcam.commands import Options
    from modalcam.pipeline import Progress, RunResult


def render(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="CONFIG|OUT",
            help="experiment.toml with beam, camera and markers; or the folder of a finished run.",
        ),
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="Video to write.")],
    recording: Annotated[
        str | None, typer.Option(help="Recording of a finished run to simulate and render.")
    ] = None,
    mode: Annotated[int, typer.Option(min=1, help="Mode to excite.")] = 1,
    tip_amplitude_mm: Annotated[float, typer.Option(min=0.0, help="Steady amplitude of the tip.")] = 1.0,
    damping_ratio: Annotated[
        float, typer.Option(min=0.0, max=0.5, help="Damping ratio of every mode.")
    ] = 0.003,
    shake_s: Annotated[float, typer.Option(min=0.0, help="Steady excitation before the stop.")] = 0.5,
    decay_s: Annotated[float, typer.Option(min=0.0, help="Free decay after the stop.")] = 3.0,
    bare: Annotated[
        bool, typer.Option("--bare", help="Film the beam itself, seen from its edge, without markers.")
    ] = False,
    truth: Annotated[
        Path | None,
        typer.Option(
            help="File for the true positions in each frame (.npz): of the markers, or along the bare beam."
        ),
    ] = None,
    seed: Seed = 0,
    force: Replace = False,
    verbose: Verbose = 0,
) -> None:
    """Render footage of a simulated beam.

    With a configuration, the beam is excited in one mode and then released, in front of the configured camera. With a
    finished run, the updated beam decays from the state fitted to a recording, with the identified damping; the
    options of the excitation do not apply.
    """
    from modalcam.apps.film.beam import film_config, film_run
    from modalcam.console import listener
    from sim.render import SUFFIXES, RecordingPlan

    if out.suffix.lower() not in SUFFIXES:
        msg = f"-o: expected a name ending in {', '.join(SUFFIXES)}; found {shown(str(out))}"
        raise ModalcamError(msg)
    check_new(out, force=force)
    finished_run = source.is_dir()
    if truth is not None:
        check_new(truth, force=force)
    if recording is not None and not finished_run:
        msg = f"--recording: expected the folder of a finished run, found {source}"
        raise ModalcamError(msg)
    if finished_run and (bare or truth is not None):
        msg = f"{'--bare' if bare else '--truth'}: expected a configuration, found the folder {source}"
        raise ModalcamError(msg)
    plan = RecordingPlan(
        mode_number=mode, tip_amplitude_m=1e-3 * tip_amplitude_mm, shake_s=shake_s, decay_s=decay_s
    )
    with listener(console(), verbose) as progress:
        if finished_run:
            film_run(run_options(source, seed=seed, jobs=1), recording, out, progress)
        else:
            film_config(source, out, plan, damping_ratio, seed, progress, bare=bare, truth=truth)
    typer.echo(str(out))


@takes("seed", "jobs")
def demo(
    out: Annotated[Path, typer.Argument(help="Folder for the footage and the results.")],
    common: dict[str, Any],
    modes: Annotated[str, typer.Option(help="Modes to excite, separated by commas.")] = "2,3",
    verbose: Verbose = 0,
) -> None:
    """Render footage of a simulated beam and run the whole pipeline."""
    from modalcam import commands
    from modalcam.apps.film.beam import film_demo

    def film_and_run(options: Options, progress: Progress) -> RunResult:
        folder = film_demo(out / "videos", _mode_list(modes), options.seed, progress)
        return commands.run(folder, options, progress)

    compute(film_and_run, run_options(out / "results", **common), verbose)


def _mode_list(text: str) -> tuple[int, ...]:
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isdecimal() and 1 <= int(part) <= 5 for part in parts):
        msg = f"--modes: expected mode numbers from 1 to 5 separated by commas, found {text!r}"
        raise ModalcamError(msg)
    return tuple(sorted({int(part) for part in parts}))


def preview(
    source: Annotated[Path, typer.Argument(metavar="OUT", help="Folder of a finished run.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Film to write: .mp4, .mkv, .mov or .gif.")],
    recording: Annotated[str | None, typer.Option(help="Recording of the run, if it holds several.")] = None,
    mode: Annotated[int | None, typer.Option(min=1, help="Number of the mode; default: the target.")] = None,
    exaggerate: Annotated[
        float | None,
        typer.Option(
            min=1e-3,
            max=1e6,
            metavar="FACTOR",
            help="Factor on the motion at the start of the fit; default: up to 8 % of the line's length.",
        ),
    ] = None,
    force: Replace = False,
) -> None:
    """Film a beam in an identified mode, its motion exaggerated.

    A line is moved in its first frame; markers are drawn over it.
    """
    from modalcam.apps.film.beam import chosen_recording
    from modalcam.apps.film.exaggerated import ExaggeratedFilm, exaggerated_film, marker_film, write_film
    from modalcam.pipeline import load_run
    from modalcam.report import shown_mode
    from modalcam.report.style import mode_name
    from modalcam.tables import check_suffix
    from tracker.markers import kind_of

    check_suffix(out, "--out")
    check_new(out, force=force)
    one, found, tracks = chosen_recording(load_run(source).recordings, recording, source)
    picked = shown_mode(found) if mode is None else next((m for m in found.modes if m.number == mode), None)
    if picked is None:
        numbers = (
            ", ".join(str(m.number) for m in found.modes if m.number is not None) or "none with a number"
        )
        msg = f"{one.name}: mode {mode or ''} was not identified; its modes are {numbers}"
        raise InputError(msg)
    film = exaggerated_film if kind_of(tracks.kind).follows_line else marker_film
    made = film(tracks, found, picked, exaggerate)
    if not isinstance(made, ExaggeratedFilm):
        msg = f"{one.name}: {made.reason}"
        raise ModalcamError(msg)
    write_film(out, made, mode_name(picked))
    typer.echo(f"{out}: motion x {made.factor:g}")


register_command(demo, "Without recordings")
register_command(render, "Without recordings")
register_command(preview)
