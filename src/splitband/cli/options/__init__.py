"""Define options that several commands share, each once, and what they default to."""
