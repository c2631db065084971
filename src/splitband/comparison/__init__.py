"""Compare forecasters: protocols, trials on held-out samples, recommendation."""
