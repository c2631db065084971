"""Train networks: windows, settings and recipes, the fit.

What is handed out stands in `__init__.pyi`, and is loaded when it is used: `fit` needs torch.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
