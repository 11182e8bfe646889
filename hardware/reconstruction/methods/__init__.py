"""Reconstruction methods, one file each; all files here are registered automatically."""
