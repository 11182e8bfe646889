"""The scene as the radar meets it: triangles, materials, slabs, mirror images, what to trace."""
