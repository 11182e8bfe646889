"""Mermaid diagrams as text: drawn where a viewer knows the language, readable in the site, which
fetches no script from elsewhere.
"""

from typing import Any

from docutils import nodes
from sphinx.util.docutils import SphinxDirective


class Diagram(SphinxDirective):
    """The source of a diagram as a literal block."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """One node, highlighted as plain text."""
        text = "\n".join(self.content)
        block = nodes.literal_block(text, text)
        block["language"] = "text"
        return [block]


def setup(app: Any) -> dict[str, bool]:
    """Sphinx's entry point."""
    app.add_directive("mermaid", Diagram)
    return {"parallel_read_safe": True}
