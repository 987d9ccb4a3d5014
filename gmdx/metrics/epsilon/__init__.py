"""The epsilon quality, with proved bounds."""
