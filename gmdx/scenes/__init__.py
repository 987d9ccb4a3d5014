"""Grippers, models, objects at rest, depth images."""
