"""Define recurrent networks and their free runs; the plain loop is the definition.

`__init__.pyi` lists the exports, loaded with torch on first use.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
