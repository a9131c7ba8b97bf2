"""Command line of modalcam, a file for each command. Heavy imports stay inside the commands: --help answers at once."""

from modalcam.cli.app import app, main

__all__ = ["app", "main"]
