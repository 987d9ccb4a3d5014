"""Convex hulls of an object, and how close they come to its surface."""
