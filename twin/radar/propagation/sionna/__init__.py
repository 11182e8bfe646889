"""Paths traced by Sionna RT."""
