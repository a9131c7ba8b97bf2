"""One self-contained HTML page from what a run found: no script, no request, same input, same bytes."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
