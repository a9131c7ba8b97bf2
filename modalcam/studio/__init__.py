"""The studio: recordings to a report in a browser on this machine, over the same pipeline and `experiment.toml`.

The modules of this folder are the model, which knows no browser; `views` shows it with NiceGUI, and `server` serves it
to this machine alone.
"""
