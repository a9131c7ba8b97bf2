"""The studio: recordings to a report in a browser on this machine, over the same pipeline and `experiment.toml`.

The files of this folder are the model, which knows no browser; `views` shows it with NiceGUI, and `server` serves it
to this machine alone.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
