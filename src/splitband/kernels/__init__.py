"""Fused rollouts: forward and backward of a whole free run, warm-up included, in one call."""

from splitband.kernels.gru import gru_rollout

__all__ = ["gru_rollout"]
