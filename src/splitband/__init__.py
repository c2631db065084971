"""Learn dynamic models from measured data: linear models, networks, hybrids and baselines.

`__init__.pyi` lists the public names. A name is loaded when it is first used, as torch and pandas
take seconds.
"""

import lazy_loader

__version__ = "0.3.0.dev0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
