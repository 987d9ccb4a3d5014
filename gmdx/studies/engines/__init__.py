"""Engines against each other, and against closed forms."""
