"""Batched array kernels: pure arrays in and out, importing nothing from gmdx."""
