"""Figures about the pipeline itself: speed, and later bias and sensitivity."""
