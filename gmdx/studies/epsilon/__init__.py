"""Ways to compute the epsilon quality, compared."""
