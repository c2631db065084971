"""What predicts, by name."""
