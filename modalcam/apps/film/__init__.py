"""Films: the simulated beam as the camera would have seen it, previews, and footage to try the pipeline with."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
