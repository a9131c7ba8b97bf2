"""From pixels and time stamps to millimetres and seconds: lens, plane, scale, exposure, time axis."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
