"""Learn dynamics models from measured records, their slow and fast parts by different means.

What the package hands out stands once, in `__init__.pyi`: a line there is all that a name needs. It
is loaded when it is used, as torch and pandas take seconds.
"""

import lazy_loader

__version__ = "0.3.0.dev0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
