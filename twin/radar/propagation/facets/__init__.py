"""Echoes of bodies by exact facets and tubes, to a tolerance of every body."""
