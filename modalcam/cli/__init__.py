"""Command line of modalcam. Heavy imports stay inside the commands, so that --help is shown at once."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
