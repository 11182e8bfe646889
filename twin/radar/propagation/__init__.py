"""Every way from the radar through the scene and back."""
