"""Compile whole rollouts: warm-up and free run in one call, their gradients in another.

The plain loop, `networks.rollout`, is the definition; kernels take a cell's tensors and return
equal samples and gradients, on the CPU in float32 and float64. Numba compiles a kernel on its first
call, with a line in the log, and keeps it on disk. Kernels are imported from their own files: the
one for differential equations needs no torch.
"""
