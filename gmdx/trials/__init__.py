"""Simulated executions of grasps."""
