"""Options that several commands share, each written down once, and what they default to."""
