"""Names: functions, arguments and variables are called by what they do or hold."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import dolfinx_tresca

PACKAGE = Path(dolfinx_tresca.__file__).parent

#: Words that say nothing about a quantity, and that a search finds everywhere.
EMPTY = {
    *("one", "some", "found", "other", "others", "known", "first", "last", "part", "parts"),
    *("thing", "at", "of", "there", "here", "now", "rest"),
}

#: The folders whose names are checked, "" for the files that are in none.
ROOMS = (
    "",
    *sorted(folder.name for folder in PACKAGE.iterdir() if (folder / "__init__.py").exists()),
)

#: (file, name) -> why the name stays.
EXCEPTIONS = {
    ("scene/obstacle.py", "other"): "what Python's documentation calls the operand of __eq__",
    ("result.py", "other"): "public: users may write resultants_between(body, other=...)",
    ("scene/obstacle.py", "at"): "public: RigidObstacle.at, which a demo calls",
    ("derivatives/goals.py", "of"): "public: ContactTangent.of, the change of a goal",
    ("table.py", "of"): "public: Units.of, as in units.of('energy')",
}


def names(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield line and name of all functions, arguments, variables and attributes that are set."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node.lineno, node.name
        elif isinstance(node, ast.arg):
            yield node.lineno, node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.id
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.attr


def empty_names(room: str) -> list[tuple[str, int, str]]:
    """Return file, line and name for each name in a folder that says nothing."""
    files = sorted((PACKAGE / room).rglob("*.py") if room else PACKAGE.glob("*.py"))
    assert files, room
    return [
        (file.relative_to(PACKAGE).as_posix(), line, name)
        for file in files
        for line, name in names(ast.parse(file.read_text(encoding="utf-8")))
        if name in EMPTY
    ]


@pytest.mark.parametrize("room", ROOMS)
def test_names_say_what_they_hold(room: str) -> None:
    """No function, argument, variable or attribute has an empty name, but for the exceptions."""
    wrong = [
        f"{file}:{line}: {name}"
        for file, line, name in empty_names(room)
        if (file, name) not in EXCEPTIONS
    ]
    assert not wrong, "call these by the quantity or the action: " + ", ".join(wrong)


def test_exceptions_are_needed() -> None:
    """Each exception is a name that is still there."""
    present = {(file, name) for room in ROOMS for file, _, name in empty_names(room)}
    assert set(EXCEPTIONS) <= present, set(EXCEPTIONS) - present
