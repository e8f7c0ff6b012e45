"""Networks: declared components, their per-unit arrays, branch equations, and network files."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
