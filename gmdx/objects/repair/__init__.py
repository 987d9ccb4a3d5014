"""From the triangles in a file to a closed surface."""
