"""Train networks: windows, settings and recipes, the fit.

`__init__.pyi` lists the exports, loaded on first use: `fit` needs torch.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
