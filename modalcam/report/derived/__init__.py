"""Quantities that the report derives from the results: signals of one mode, scatter of tracks, thinned traces."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
