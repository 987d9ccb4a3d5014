"""Meshes in, prepared objects out."""
