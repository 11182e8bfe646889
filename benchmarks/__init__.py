"""What the README quotes, measured: ``make bench``."""
