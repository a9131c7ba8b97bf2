"""An experiment predicted before it is filmed: intervals of frequency and damping per mode, and what limits each."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
