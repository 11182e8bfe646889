"""The commands of `ugv`."""
