"""Fits of the decays of a record, divided until free decays explain each piece."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
