"""Identify linear state-space models: subspace first, then refined to the least error."""
