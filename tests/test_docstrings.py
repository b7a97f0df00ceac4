"""Docstrings: examples give what they say; summaries and entries can be read alone."""

from __future__ import annotations

import ast
import doctest
import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

import dolfinx_tresca

#: The main classes, and the function that begins most scripts.
WITH_EXAMPLE = (
    "ContactPair",
    "ContactProblem",
    "ContactSolution",
    "SolverOptions",
    "Tresca",
    "read_gmsh",
)

#: Pronouns and relatives: a text that begins with one makes sense only with another text.
DEPENDENT = ("that", "those", "what", "it", "its", "they", "of", "where", "as")
SUMMARY = re.compile(rf"({'|'.join(DEPENDENT)}|the same)\b", re.IGNORECASE)
ENTRY = re.compile(rf"({'|'.join(DEPENDENT)}|which|whose)\b", re.IGNORECASE)


def examples(name: str) -> list[doctest.DocTest]:
    """Return the examples of a public name and of its methods."""
    found = doctest.DocTestFinder().find(getattr(dolfinx_tresca, name), name)
    return [test for test in found if test.examples]


def run(name: str, names: dict[str, Any]) -> None:
    """Run examples; `names` are what they know, and get what they define."""
    for test in examples(name):
        test.globs = names
        report: list[str] = []
        failed, _ = doctest.DocTestRunner().run(test, out=report.append, clear_globs=False)
        assert failed == 0, "".join(report)


@pytest.fixture(scope="module")
def cube() -> dict[str, Any]:
    """The names that the example of ContactProblem defines; others refer to them."""
    names: dict[str, Any] = {}
    run("ContactProblem", names)
    return names


@pytest.mark.parametrize("name", [name for name in dolfinx_tresca.__all__ if examples(name)])
def test_examples_give_what_they_say(comm, cube, monkeypatch, name):
    monkeypatch.chdir(Path(__file__).parents[1])
    run(name, dict(cube))


@pytest.mark.parametrize("name", WITH_EXAMPLE)
def test_what_scripts_begin_with_has_an_example(name):
    assert examples(name)


def dependent_texts(source: str) -> Iterator[tuple[int, str]]:
    """Yield line and text of summaries and entries that begin with a pronoun or a relative."""
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, documented) or (text := ast.get_docstring(node)) is None:
            continue
        in_entries = False
        for line, words in enumerate(text.splitlines(), start=node.body[0].lineno):
            if words and not words.startswith(" "):
                in_entries = words in ("Args:", "Attributes:")
            entry = re.match(r"    (\*{0,2}\w+): (\([^)]*\),? *)?(.*)", words)
            if (line == node.body[0].lineno and SUMMARY.match(words)) or (
                in_entries and entry and ENTRY.match(entry[3])
            ):
                yield line, words.strip()


def test_summaries_and_entries_can_be_read_alone():
    folder = Path(dolfinx_tresca.__file__).parent
    found = [
        f"{file.relative_to(folder.parent)}:{line}: {text}"
        for file in sorted(folder.rglob("*.py"))
        for line, text in dependent_texts(file.read_text(encoding="utf-8"))
    ]
    assert not found, "begin with a noun or a verb:\n" + "\n".join(found)


def test_pages_of_rooms_name_what_exists():
    """A name is in the code of the class or module before it; a private one in its own room."""
    package = Path(dolfinx_tresca.__file__).parent
    sources = {file: file.read_text() for file in package.rglob("*.py")}
    code_of: dict[str, str] = {}
    for file, source in sources.items():
        code = source if file.name != "__init__.py" else ""
        for name in (file.stem, *file.relative_to(package).parts[:-1], ""):
            code_of[name] = code_of.get(name, f"{name} py pvd") + f" {file.stem} {code}"
        for node in ast.parse(source).body:
            if isinstance(node, ast.ClassDef):
                code_of[node.name] = code_of.get(node.name, "") + ast.unparse(node)
    missing = []
    for page in (file for file in sources if file.name == "__init__.py"):
        for words in re.findall(r"`([\w.]+)`", ast.get_docstring(ast.parse(sources[page])) or ""):
            for owner, name in pairwise(["", *words.strip(".").split(".")]):
                is_private = name.startswith("_") and not owner
                code = code_of.get(page.parent.name if is_private else owner, code_of[""])
                if not re.search(rf"\b{name}\b", code):
                    missing.append(f"{page.parent.name}: {words}")
    assert not missing, f"no such names in the package: {missing}"
