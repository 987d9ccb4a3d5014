"""Planar grasps and their analytical contacts."""
