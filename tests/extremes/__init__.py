"""Every axis of the twin pushed until a result leaves its stated error, against an oracle.

`make extremes` prints the table and writes ``docs/extremes.md``; pytest checks the same cases.
"""
