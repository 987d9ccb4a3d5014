"""The 36 grasp metrics."""
