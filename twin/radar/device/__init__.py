"""The radar as a device: its design, antennas, oscillator, front end."""
