"""``python -m hardware`` is the command ``ugv``."""

from hardware.cli import main

main()
