"""Define models of a record: networks to train, and simulation from a warm-up.

`training.loop` needs only a model's `tasks`: networks and their target signals. Training and
simulation call the same methods, so that networks have equal kinds of inputs in both.
`__init__.pyi` lists the exports, loaded with torch on first use.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
