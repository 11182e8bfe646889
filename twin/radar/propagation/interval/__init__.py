"""Echoes over an interval in which the world moves: one instant, or as many as it takes."""
