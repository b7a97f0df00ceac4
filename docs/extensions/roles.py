"""{test}`tests/file.py::name`: the test that a statement rests on.

tests/test_docs.py looks whether there is such a test.
"""

from __future__ import annotations

from typing import Any

from docutils import nodes
from sphinx.util.docutils import SphinxRole


class Test(SphinxRole):
    """The name of a test."""

    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        """Return it, short: the file and where it lives go to the tip that a pointer shows."""
        path, _, name = self.text.partition("::")
        short = nodes.literal(self.text, name, classes=["test"])
        abbreviation = nodes.abbreviation("", "", short, explanation=f"{path}::{name}")
        return [abbreviation], []


def setup(app: Any) -> dict[str, bool]:
    """Register with Sphinx."""
    app.add_role("test", Test())
    return {"parallel_read_safe": True}
