"""`modalcam paper`: the tables and figures of the paper compared with the results of a folder of recordings."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
