"""Define recurrent networks and their free runs; the plain loop is the definition.

What is handed out stands in `__init__.pyi`, and is loaded with torch when it is used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
