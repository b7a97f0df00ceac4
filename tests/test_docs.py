"""Pages of the site: their code runs, and what they name is there. `make docs` builds them."""

from __future__ import annotations

import ast
import gc
import importlib.util
import re
import shlex
import subprocess
import sys
from collections import Counter
from itertools import dropwhile
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest

import ufl
from dolfinx import fem

import dolfinx_tresca
from dolfinx_tresca.stiffness.choice import CHOLESKY_LIMITS
from scenes.boxes import Body, boxes
from scenes.two_bricks import two_bricks

CHECKOUT = Path(__file__).parents[1]
DOCS = CHECKOUT / "docs"
README = CHECKOUT / "README.md"
PAGES = [
    page for page in sorted(DOCS.rglob("*.md")) if not page.match("tutorials/demo_*")
]  # demos have a test of their own

sys.path.insert(0, str(DOCS))
from extensions.cells import blocks, cells_of  # noqa: E402

#: What commands of pages begin with, beside make and tools/: not all of them are on any machine.
PROGRAMS = {"~/contact/bin/pip", *"add-apt-repository apt-get conda docker mpirun pip".split()}
PROGRAMS |= {"python", "python3"}


#: Packages whose code on pages is run where they are installed.
OPTIONAL = ("dolfinx_adjoint", "jax", "meshio", "torch")


def name(page: Path) -> str:
    """Return what pytest shows of a page."""
    return str(page.relative_to(CHECKOUT).with_suffix("")).removeprefix("docs/")


def of_language(language: str) -> list[Path]:
    """Return the pages of the site with code in a language."""
    return [page for page in PAGES if blocks(page.read_text(), language)]


def slug(heading: str) -> str:
    """Return what a heading is called in links."""
    return re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-")


@pytest.fixture
def names(comm) -> dict[str, Any]:
    """What pages that are no whole scripts take for given: the two bricks, solved."""
    scene = two_bricks(comm, 3)
    bound = fem.Constant(scene.mesh, 0.09)
    scene = scene.but(friction=dolfinx_tresca.Tresca(bound))
    problem = scene.problem()
    square = boxes(comm, "triangle", [Body((4, 4), [(0.0, 1.0), (0.0, 1.0)])])
    sides = {"bottom": (1, 0.0), "top": (1, 1.0), "left": (0, 0.0)}
    marks = [
        (tag, [0], lambda x, axis=axis, at=at: abs(x[:, axis] - at) < 1e-9)
        for tag, (axis, at) in enumerate(sides.values(), start=1)
    ]
    tags = {name: tag for tag, name in enumerate(sides, start=1)}
    block = dolfinx_tresca.TaggedMesh(square.mesh, None, square.tags(*marks), tags)
    return {
        **{public: getattr(dolfinx_tresca, public) for public in dolfinx_tresca.__all__},
        **{"np": np, "ufl": ufl, "fem": fem, "MPI": MPI, "Path": Path, "comm": comm},
        **{
            key: getattr(scene, key) for key in ("V", "a", "L", "bcs", "pair", "facet_tags", "tags")
        },
        **{"bound": bound, "load": scene.data.load, "loads": (0.5, 1.0), "block": block},
        **{"problem": problem, "solution": problem.solve(), "fit": scene, "pairs": scene.pairs},
        "von_mises": fem.Function(fem.functionspace(scene.mesh, ("DG", 0)), name="von Mises"),
    }


def test_every_block_is_run_or_made():
    """A page has Python, commands, and what the build makes: nothing that no test looks at."""
    markdown = pytest.importorskip("markdown_it").MarkdownIt()
    made = {"{toctree}", "{include}", "{literalinclude}", "{measured}", "{printed}", "{eval-rst}"}
    made.add("{layers}")
    for page in PAGES:
        text = page.read_text()
        tokens = markdown.parse(text)
        kinds = Counter(token.info.partition(" ")[0] for token in tokens if token.type == "fence")
        run = Counter({language: len(blocks(text, language)) for language in ("python", "sh")})
        assert {kind: n for kind, n in kinds.items() if kind not in made} == +run, name(page)
        assert all(token.type != "code_block" for token in tokens), name(page)
        assert "\t" not in text, (
            f"{name(page)}: a tab, such as a formula whose \\t was taken for one"
        )


def test_pages_import_mpi_before_dolfinx():
    """DOLFINx from PyPI is only found after MPI was loaded; here another test has loaded it."""
    for page in [README, *of_language("python")]:
        code = "\n".join(block.text for block in blocks(page.read_text(), "python"))
        imports = [
            module
            for module in re.findall(r"^(?:from|import) (\w+)", code, re.MULTILINE)
            if module in ("mpi4py", "dolfinx", "dolfinx_tresca")
        ]
        assert "mpi4py" not in imports or imports[0] != "dolfinx", name(page)


@pytest.mark.parametrize("page", of_language("python"), ids=name)
def test_python(names, tmp_path, monkeypatch, page):
    """All blocks of a page, one after the other."""
    monkeypatch.chdir(tmp_path)
    for number, cell in enumerate(cells_of(page)):
        if number == 0 and "import MPI" in cell.text:  # a whole script
            names.clear()
        needs = re.findall(r"^import (\w+)", cell.text, re.MULTILINE)
        if any(one in OPTIONAL and importlib.util.find_spec(one) is None for one in needs):
            continue
        code = "\n" * (cell.line - 1) + cell.text
        exec(compile(code, str(page), "exec"), names)
    # DOLFINx's VTKFile writes its file again when it is collected, then into another folder
    names.clear()
    gc.collect()


def test_the_script_of_the_readme(tmp_path, monkeypatch):
    """README shows the package's whole example, and lines of the kind that it prints."""
    (script,) = blocks(README.read_text(), "python")
    code = Path(dolfinx_tresca.__file__).with_name("example.py").read_text()
    _docstring, _, code = code.partition("\n\n")
    assert script.text.strip() == code.strip()
    assert len(code.splitlines()) <= 42
    drawn: list[str] = []  # for good by the page of the first script: that takes seconds
    monkeypatch.setattr(dolfinx_tresca.ContactSolution, "plot", lambda _, path: drawn.append(path))
    monkeypatch.chdir(tmp_path)
    assert "N=16)" in code
    names: dict[str, Any] = {}
    exec(code.replace("N=16)", "N=3)"), names)
    assert Path("results/two_bricks.pvd").exists()
    assert drawn == ["results/two_bricks.png"]
    (printed,) = re.findall(r"^    (status .*?)\n\n", README.read_text(), re.M | re.S)
    label = slice(len("contact nodes"))
    shows, lines = (  # rounding decides whether some node is undecided with N=3
        [line for line in text.splitlines() if "undecided" not in line]
        for text in (printed, str(names["solution"]))
    )
    for shown, line in zip(shows, lines, strict=True):
        assert shown.removeprefix("    ")[label] == line[label]


def test_products_of_the_readme_are_those_measured():
    pytest.importorskip("sphinx")
    tables = importlib.import_module("extensions.measured").tables()
    first, second = ({row[0]: row for row in tables[f"paper_free_end_{end}"][1]} for end in (1, 2))
    shown = re.findall(r"^\| (\d+ / \d+) \| (.*) \|$", README.read_text(), re.M)
    assert set(dict(shown)) == set(second)
    for size, cells in shown:
        _, ours, _, imssn, _, ssn, *_ = second[size]
        kept = [first[size][1], ours, imssn, ssn]
        assert cells.split(" | ") == [cell.strip("*") for cell in kept]


def test_links_of_the_readme_lead_somewhere():
    for target in re.findall(r"\]\((?!https:)([^)]+)\)", README.read_text()):
        path, _, anchor = target.partition("#")
        assert (CHECKOUT / path).exists(), target
        if anchor:
            headings = re.findall(r"^#+ (.*)$", (CHECKOUT / path).read_text(), re.M)
            assert anchor in map(slug, headings), target


@pytest.mark.parametrize("page", [README, *of_language("sh")], ids=name)
def test_shell(page):
    """Commands parse; targets of make, files, and extras of the package are there."""
    targets = re.findall(r"^([a-z-]+):", (CHECKOUT / "Makefile").read_text(), re.MULTILINE)
    extras = re.findall(r"^([a-z]+) = \[", (CHECKOUT / "pyproject.toml").read_text(), re.MULTILINE)
    for block in blocks(page.read_text(), "sh"):
        subprocess.run(["sh", "-n"], input=block.text, text=True, check=True)
        for line in block.text.replace("\\\n", " ").splitlines():
            words = shlex.split(line, comments=True)
            first, *rest = dropwhile(lambda word: word == "time" or "=" in word, words)
            if first == "make":
                assert rest and set(rest) <= set(targets), line
            elif first.startswith("tools/"):
                assert (CHECKOUT / first).exists(), line
            else:
                assert first in PROGRAMS, line
            for word in rest:
                if word.startswith(("demos/", "benchmarks/", "tests/")):
                    assert (CHECKOUT / word).exists(), line
            for listed in re.findall(r"[.a]\[([a-z,]+)\]", line):
                assert set(listed.split(",")) <= set(extras), line


def test_debian_packages_are_those_of_the_tools():
    listed = (CHECKOUT / "tools" / "debian-packages.txt").read_text()
    known = {line.partition("#")[0].strip() for line in listed.splitlines()}
    # what the wheels from PyPI need instead
    venvs = (CHECKOUT / "tools" / "venvs.py").read_text()
    known |= {"libc6-dev", *re.findall(r'^PACKAGES = "(.*)"$', venvs, re.M)[0].split()}
    page = (DOCS / "start" / "install.md").read_text().replace("\\\n", " ")
    installed = re.findall(r"apt-get install (.*)", page)
    assert installed
    for line in installed:
        assert set(line.split()) <= known


def test_the_page_on_pypi():
    """The page has the commands of README.md and of the page on installing, and no links."""
    page = (CHECKOUT / "packaging" / "pypi.md").read_text()
    assert not re.search(r"\]\(|://", page)
    known = README.read_text() + (DOCS / "start" / "install.md").read_text()
    for block in blocks(page, "sh"):
        for line in block.text.splitlines():
            command = line.partition("#")[0].strip()
            assert command.removesuffix(" dolfinx_tresca") in known, line


def test_supported_versions_are_those_of_the_tools():
    tools = (CHECKOUT / "tools" / "venvs.py").read_text()
    (first, last) = re.findall(r"^SUPPORTED = \(0, (\d+)\), \(0, (\d+)\)$", tools, re.M)[0]
    every = [f"0.{minor}" for minor in range(int(first), int(last) + 1)]
    for page in ("changelog.md", "start/install.md"):
        versions = re.search(r"DOLFINx (0[\d., ]* (?:and|or) 0\.\d+)", (DOCS / page).read_text())
        assert versions and re.findall(r"0\.\d+", versions[1]) == every, page


def test_tests_that_pages_name():
    """The theory rests on tests: each that it names is one."""
    named = {found for page in PAGES for found in re.findall(r"{test}`([^`]+)`", page.read_text())}
    assert len(named) > 40
    for path, _, function in sorted(found.partition("::") for found in named):
        tree = ast.parse((CHECKOUT / path).read_text())
        there = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
        assert function in there, f"{path}::{function}"


def test_functions_named_by_pages_exist():
    named = {one for page in PAGES for one in re.findall(r"{source}`([^`]+)`", page.read_text())}
    assert len(named) > 10
    for path, _, name in sorted(one.partition("::") for one in named):
        body = ast.parse((CHECKOUT / "dolfinx_tresca" / path).read_text()).body
        for part in name.split("."):
            found = [one for one in body if getattr(one, "name", None) == part]
            assert found, f"{path}::{name}"
            body = getattr(found[0], "body", [])


def test_the_table_of_imports_goes_downwards():
    """Each room imports rooms of layers below its own."""
    pytest.importorskip("sphinx")
    architecture = importlib.import_module("extensions.architecture")
    level = {room: i for i, layer in enumerate(architecture.layers()) for room in layer}
    imports = architecture.imports()
    assert imports["problem"] and imports["solvers"]
    for room, below in imports.items():
        assert all(level[room] < level[name] for name in below), room


def test_reference_has_each_public_name_once():
    text = "".join(page.read_text() for page in (DOCS / "api").glob("*.md"))
    found = Counter(re.findall(r"^\.\. auto(?:class|function|data|exception):: (\w+)$", text, re.M))
    assert found == Counter(dolfinx_tresca.__all__)
    listed = re.findall(r"^   (\w+)$", (DOCS / "api" / "index.md").read_text(), re.M)
    assert Counter([*listed, "MESHES"]) == Counter(dolfinx_tresca.__all__)


def test_every_demo_has_a_card():
    cards = re.findall(r":link: (demo_\w+)", (DOCS / "tutorials" / "index.md").read_text())
    assert sorted(cards) == sorted(demo.stem for demo in (CHECKOUT / "demos").glob("*.py"))


def wording(node: ast.expr) -> str:
    """Return a message as the source has it, with ... for what it is given."""
    match node:
        case ast.Constant():
            return str(node.value)
        case ast.JoinedStr():
            return "".join(map(wording, node.values))
        case ast.BinOp():
            return wording(node.left) + wording(node.right)
        case ast.IfExp():
            return f"{wording(node.body)} {wording(node.orelse)}"
    return "..."


def messages() -> list[tuple[str, str]]:
    """Return the name of the class and the message of each error, and those of warnings."""
    nodes = [
        node
        for file in (CHECKOUT / "dolfinx_tresca").rglob("*.py")
        for node in ast.walk(ast.parse(file.read_text()))
    ]
    found = []
    for node in nodes:
        if isinstance(node, ast.FunctionDef) and node.name == "failure":  # raised by its caller
            for returned in ast.walk(node):
                if isinstance(returned, ast.Return) and isinstance(returned.value, ast.JoinedStr):
                    message = wording(returned.value)
                    kind = "OutsideTheoryError" if "theory" in message else "ConvergenceError"
                    found.append((kind, message))
    for call in (node for node in nodes if isinstance(node, ast.Call)):
        match call.func, call.args:
            case ast.Name("log"), [_, message, *_] if "WARNING" in ast.dump(call):
                found.append(("warning", wording(message)))
            case ast.Name("warn"), [_, message, *_]:
                found.append(("warning", wording(message)))
            case ast.Attribute(attr="warning"), [message, *_]:
                found.append(("warning", wording(message)))
            case ast.Name(name), [message, *_] if name.endswith("Error"):
                found.append((name, wording(message)))
    return [(name, message) for name, message in found if message not in ("...", "%s")]


def explained(section: str) -> dict[str, list[re.Pattern[str]]]:
    """Return for each class of errors what the tables below its name quote of messages."""
    found: dict[str, list[re.Pattern[str]]] = {}
    for part in re.split(r"^(?=\*\*|## )", section, flags=re.MULTILINE):
        kind = re.match(r"\*\*.*`(\w+)`|## Warnings", part)
        if kind is None:
            continue
        for quoting in re.findall(r"^\| (.*?) \| ", part, re.MULTILINE):
            for phrase in re.findall(r'"([^"]*)"', quoting):
                pattern = ".*".join(map(re.escape, phrase.split("…")))
                found.setdefault(kind[1] or "warning", []).append(re.compile(pattern))
    return found


def test_debugging_explains_errors_and_warnings():
    """All quoted messages exist, and all messages but those of wrong arguments are quoted."""
    page = (DOCS / "how-to" / "debugging.md").read_text()
    phrases = explained(page[page.index("## Errors") : page.index("## How a solve ends")])
    public = {
        name
        for name in dolfinx_tresca.__all__
        if isinstance(kind := getattr(dolfinx_tresca, name), type) and issubclass(kind, Exception)
    }
    assert set(phrases) == {*public, "warning"}
    said = messages()
    for name, patterns in phrases.items():
        for pattern in patterns:
            assert any(n == name and pattern.search(message) for n, message in said), pattern
    for name, message in said:
        if name in phrases and name != "InputError":
            assert any(pattern.search(message) for pattern in phrases[name]), (name, message)


@pytest.mark.parametrize("enum", ["ContactStatus", "AdaptiveStatus"])
def test_debugging_explains_every_status(enum):
    page = (DOCS / "how-to" / "debugging.md").read_text()
    assert all(f"`{status.name}`" in page for status in getattr(dolfinx_tresca, enum))


def test_limits_of_the_choice_are_those_of_the_code():
    page = (DOCS / "start" / "choices.md").read_text()
    once = CHOLESKY_LIMITS
    for text in (page, (CHECKOUT / "benchmarks" / "README.md").read_text()):
        assert f"bodies of up to {once[3]:,} unknowns in 3D ({once[2]:,} in 2D)" in text


def test_the_paper():
    """References and pictures exist; the length is the journal's; seconds are those measured."""
    folder = CHECKOUT / "paper"
    text = (folder / "paper.md").read_text()
    keys = re.findall(r"^@\w+{(\w+),", (folder / "paper.bib").read_text(), re.MULTILINE)
    assert sorted(keys) == sorted(set(re.findall(r"(?<!\w)@(\w+)", text)))
    pictures = re.findall(r"!\[[^]]*\]\(([^)]+)\)", text)
    assert pictures and all((folder / picture).exists() for picture in pictures)
    _, _, body = re.sub(r"!\[[^]]*\]\([^)]+\)", "", text).split("---\n", 2)
    assert 750 <= len(body.split()) <= 1750
    (title,) = re.findall(r'^title: "(.*)"$', (CHECKOUT / "CITATION.cff").read_text(), re.MULTILINE)
    assert f'title: "{title}"' in text
    pytest.importorskip("sphinx")
    tables = importlib.import_module("extensions.measured").tables()
    seconds = {row[0].strip("*"): row[2] for row in tables["peers"][1]}
    for solver, words in {
        "ours, Cholesky": "the package takes {}",
        "SCS, primal cone program, sparse": "SCS [@scs] {}",
        "monolithic semismooth Newton, Alart and Curnier": "with MUMPS {}",
        "GetFEM, its own assembly and Newton method": "GetFEM {}",
        "Clarabel, dual cone program, dense A": "Clarabel [@clarabel] {}",
        "Clarabel, primal cone program, sparse": "dual and {}",
    }.items():
        assert words.format(seconds[solver].strip("*")) in " ".join(text.split()), solver


def test_files_that_pages_name():
    """Scripts, tools and data in commands; what docstrings refer to as well."""
    sources = (CHECKOUT / "dolfinx_tresca").rglob("*.py")
    for page in [*PAGES, README, CHECKOUT / "benchmarks" / "README.md", *sources]:
        pattern = r"(?<![\w/.])(?:tools|demos|benchmarks|tests|docs)/[\w/.-]*\w"
        for path in set(re.findall(pattern, page.read_text())) - {"benchmarks/data/SCRIPT.json"}:
            assert (CHECKOUT / path).exists(), f"{page.name}: {path}"
