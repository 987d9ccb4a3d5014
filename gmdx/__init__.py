"""Object meshes in, annotated planar-grasp datasets out."""
