"""What each command of `ugv` does."""
