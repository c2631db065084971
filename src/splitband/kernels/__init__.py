"""Compile whole rollouts: warm-up, free run and their gradients in one call each.

The plain loop, `networks.rollout`, is the definition; these take a cell's tensors and give the
same samples and gradients, on the CPU in float32 and float64. Numba compiles a kernel on its first
call, says so on the log, and keeps it on disk. Each kernel is imported from its own file: that of
differential equations needs no torch.
"""
