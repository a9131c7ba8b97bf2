"""The folder of the results: its files, saved results, and the hashes that decide whether they are valid."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
