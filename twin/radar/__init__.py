"""The radar twin."""
