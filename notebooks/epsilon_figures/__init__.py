"""The figures of `epsilon.md`: wrench spaces, hulls, loads."""
