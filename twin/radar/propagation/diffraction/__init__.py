"""Diffraction: paths around obstacles, and fringe currents of sharp edges."""
