"""Define the options that several commands share, with their defaults."""
