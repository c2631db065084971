"""Provide torch's optimizers without its compiler, which loads longer than a short training takes.

Torch loads the compiler with the first optimizer, only to exempt the optimizer's methods from
compilation. These classes use the methods without this wrapper; their steps are equal to the bit.
"""

from __future__ import annotations

from inspect import unwrap

import torch
from torch.optim import Optimizer


class _Plain(Optimizer):
    """The common methods of all optimizers, unwrapped."""

    add_param_group = unwrap(Optimizer.add_param_group)
    load_state_dict = unwrap(Optimizer.load_state_dict)
    state_dict = unwrap(Optimizer.state_dict)
    zero_grad = unwrap(Optimizer.zero_grad)


class Adam(_Plain, torch.optim.Adam):
    """Take the steps of `torch.optim.Adam`."""

    step = torch.no_grad()(unwrap(torch.optim.Adam.step))


class LBFGS(_Plain, torch.optim.LBFGS):
    """Take the steps of `torch.optim.LBFGS`."""
