"""The layers of the package as a picture, and the names of its functions as links to files.

The directive `layers` draws the first import contract of pyproject.toml, so the picture is what
`make check` verifies, and lists what each room imports, as the code says. {source}`file.py::name`
names a function of the package; tests/test_docs.py checks that it exists.
"""

from __future__ import annotations

import ast
from html import escape
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.util.docutils import SphinxDirective, SphinxRole

PYPROJECT = Path(__file__).parents[2] / "pyproject.toml"
PACKAGE = PYPROJECT.with_name("dolfinx_tresca")

#: Sizes of the picture in pixels: its width, the height of a layer, and the distance of boxes.
WIDTH, HEIGHT, SPACE = 640, 34, 8


def layers() -> list[list[str]]:
    """Return the rooms of each layer of the package, from the highest to the lowest."""
    import tomllib  # Python 3.11 or later, as the packages that build the site

    contracts = tomllib.loads(PYPROJECT.read_text())["tool"]["importlinter"]["contracts"]
    first = next(one for one in contracts if one.get("containers") == ["dolfinx_tresca"])
    return [[room.strip() for room in layer.split("|")] for layer in first["layers"]]


def picture() -> str:
    """Return the layers as SVG, in the colours of the page."""
    rows = layers()
    shapes = []
    for i, rooms in enumerate(rows):
        width = (WIDTH - SPACE * (len(rooms) - 1)) / len(rooms)
        for j, room in enumerate(rooms):
            x, y = j * (width + SPACE), i * (HEIGHT + SPACE)
            shapes.append(
                f'<rect x="{x + 1:.0f}" y="{y + 1}" width="{width - 2:.0f}" height="{HEIGHT - 2}" '
                'rx="4" fill="none" stroke="currentColor"/>'
                f'<text x="{x + width / 2:.0f}" y="{y + HEIGHT / 2 + 5:.0f}" fill="currentColor" '
                f'text-anchor="middle" font-size="14">{escape(room)}</text>'
            )
    height = len(rows) * (HEIGHT + SPACE)
    return (
        f'<svg viewBox="0 0 {WIDTH} {height}" role="img" style="max-width: {WIDTH}px; width: 100%">'
        "<title>Layers of the package: each imports from the layers below it only</title>"
        f"{''.join(shapes)}</svg>"
    )


def imports() -> dict[str, set[str]]:
    """Return the rooms that each room of the package imports, as its files say."""
    rooms = [room for layer in layers() for room in layer]
    result = {}
    for room in rooms:
        files = [PACKAGE / f"{room}.py", *(PACKAGE / room).rglob("*.py")]
        statements = [
            statement
            for file in files
            if file.exists()
            for statement in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        ]
        imported = {
            name
            for statement in statements
            if isinstance(statement, ast.ImportFrom) and statement.module
            for name in (
                [alias.name for alias in statement.names]
                if statement.module == PACKAGE.name
                else statement.module.removeprefix(f"{PACKAGE.name}.").split(".")[:1]
            )
        }
        result[room] = imported & set(rooms) - {room}
    return result


def table() -> str:
    """Return the imports of the rooms as an HTML table."""
    rows = "".join(
        f"<tr><td>{room}</td><td>{', '.join(name for name in imports() if name in below)}</td></tr>"
        for room, below in imports().items()
    )
    return f"<table><thead><tr><th>room</th><th>imports</th></tr></thead>{rows}</table>"


class Layers(SphinxDirective):
    """The picture of the layers."""

    def run(self) -> list[nodes.Node]:
        """Return the picture, and the table of imports."""
        self.env.note_dependency(str(PYPROJECT))
        return [nodes.raw("", picture() + table(), format="html")]


class Source(SphinxRole):
    """The name of a function or class of the package, with its file."""

    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        """Return file and name."""
        path, _, name = self.text.partition("::")
        literal = nodes.literal(self.text, f"{path}: {name}")
        return [literal], []


def setup(app: Any) -> dict[str, bool]:
    """Register with Sphinx."""
    app.add_directive("layers", Layers)
    app.add_role("source", Source())
    return {"parallel_read_safe": True}
