"""Data that ships with gmdx: grippers and bundled objects."""
