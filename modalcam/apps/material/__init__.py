"""Elastic moduli and loss factors of a material from the modes of a bar."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
