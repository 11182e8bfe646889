"""Diffraction: ways round obstacles, and fringe currents of sharp edges."""
