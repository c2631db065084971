"""The paper's systems, settings and published values, each number once."""
