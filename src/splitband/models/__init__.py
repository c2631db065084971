"""Define models of a record: what is trained, and how it simulates from a warm-up.

A model defines its networks and the signal that each must reproduce (`tasks`), which is all that
`training.loop` needs. Training and simulation call the same methods, so that a network has the same
kind of inputs in both. What is handed out stands in `__init__.pyi`, and is loaded with torch when
it is used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
