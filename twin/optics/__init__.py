"""Light: the sun in the band, closed forms, and transport through the scene."""
