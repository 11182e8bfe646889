"""Equations as MathML, which browsers draw by themselves: no script is fetched from elsewhere."""

from typing import Any

from docutils import nodes
from latex2mathml.converter import convert


def visit_inline(translator: Any, node: nodes.math) -> None:
    """An equation in the text."""
    translator.body.append(convert(node.astext()))
    raise nodes.SkipNode


def visit_block(translator: Any, node: nodes.math_block) -> None:
    """An equation by itself, which scrolls where the page is narrow."""
    drawn = convert(node.astext(), display="block")
    translator.body.append(f'<div style="overflow-x: auto; padding: 0.4em 0">{drawn}</div>\n')
    raise nodes.SkipNode


def setup(app: Any) -> dict[str, bool]:
    """Sphinx's entry point."""
    app.add_html_math_renderer("mathml", (visit_inline, None), (visit_block, None))
    return {"parallel_read_safe": True}
