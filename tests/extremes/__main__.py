"""Print the table of extremes and write it to ``docs/extremes.md``; exit 1 where one fails."""

import sys

from tests.extremes.table import main

sys.exit(main())
