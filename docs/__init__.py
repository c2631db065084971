"""Pages of the documentation, and what fills in their figures."""
