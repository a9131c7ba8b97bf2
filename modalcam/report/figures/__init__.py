"""Figures of the report, one theme a file; each function draws one and returns it with its caption."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
