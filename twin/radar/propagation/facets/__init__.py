"""Echoes of bodies by exact facets and ray tubes, to a tolerance of every body."""
