"""From a folder: its recordings; from one file, for `identify`: a series."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
