"""A run: its stages in order, the processes that compute them, the folder that keeps their results."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
