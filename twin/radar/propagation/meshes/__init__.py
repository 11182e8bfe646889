"""What meshes are by themselves, wherever they stand: flat patches, outlines, bodies."""
