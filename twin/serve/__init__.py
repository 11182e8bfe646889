"""Virtual devices: the twin behind the devices' own protocols, in device time."""
