"""Pages of the studio, made with NiceGUI from the model; nothing else imports it."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
