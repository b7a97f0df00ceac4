"""A report: one page of HTML with all that belongs to a result, and nothing from elsewhere."""

from __future__ import annotations

import base64
import re
import sys
from html.parser import HTMLParser

import pytest

from dolfinx_tresca import Coulomb, Frictionless, InputError, Preload, RigidPlane, Units
from scenes.blocks import ABOVE, BELOW, block
from scenes.patches import patch

pytestmark = pytest.mark.parallel

VOID = {"meta", "img"}


class Tags(HTMLParser):
    """Checks that all elements are closed, and keeps headings, sources and cells."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open, self.headings, self.sources, self.texts = [], [], [], []
        self.feed(text)
        self.close()

    def handle_startendtag(self, tag, attrs):
        """Elements without content need no end."""

    def handle_starttag(self, tag, attrs):
        """Open an element."""
        self.sources += [value for name, value in attrs if name in ("src", "href")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        """Close the element that was opened last."""
        assert self.open.pop() == tag

    def handle_data(self, data):
        """Keep a text."""
        self.texts.append(data)
        if self.open and self.open[-1] == "h2":
            self.headings.append(data)


def pressed(comm, **held):
    tool = RigidPlane(point=(0.5, 0.5, 1.0), normal=(0, 0, -1))
    tool.held_by(**held)
    return block(
        comm, (2, 2, 2), held=(BELOW,), load=(0, 0, 0), obstacles=[(ABOVE, tool)],
        friction=Coulomb(0.3),
    )  # fmt: skip


def test_a_report_of_two_steps(comm, tmp_path, monkeypatch):
    script = tmp_path / "script.py"
    script.write_text("problem.solve()")
    monkeypatch.setattr(sys.modules["__main__"], "__file__", str(script), raising=False)
    path = comm.bcast(tmp_path) / "new folder" / "result.html"
    problem = pressed(comm, force=(0, 0, -3.0), free=("z",)).problem(units=Units("mm", "MPa", "N"))
    before = problem.solve()
    problem.accept()
    solution = problem.solve()
    solution.report(path, steps=[before])
    text = path.read_text()
    tags = Tags(text)
    assert not tags.open
    assert tags.headings[:5] == [
        "Result", "Picture", "Forces between bodies", "Load steps", "Problem",
    ]  # fmt: skip
    assert {"Versions", "Script"} <= set(tags.headings)
    assert [source[:22] for source in tags.sources] == ["data:image/png;base64,"]
    picture = base64.b64decode(tags.sources[0][22:])
    assert picture.startswith(b"\x89PNG") and len(picture) > 10_000
    assert not re.search(r"https?://|@import|url\(", text)
    for words in ("CONVERGED", "rigid obstacles", "PETSc", "friction 0.3", "problem.solve()"):
        assert any(words in data for data in tags.texts), words
    solution.report(path)
    assert "Load steps" not in Tags(path.read_text()).headings


def test_forces_between_bodies(comm, tmp_path):
    scene = patch(comm, "tetrahedron", friction=Preload(7.0))
    before = scene.but(friction=Frictionless()).problem().solve()  # without a bolt
    path = comm.bcast(tmp_path) / "forces.html"
    scene.problem(units=Units("mm", "MPa", "N")).solve().report(path, steps=[before])
    text = path.read_text()
    assert text.count("<circle") == 2 and text.count("<line") == 1
    assert re.search(r">7\.\d*\s?N<", text) and ">body 1<" in text and ">body 2<" in text


def test_wrong_paths(comm, tmp_path):
    solution = pressed(comm, force=(0, 0, -1.0), free=("z",)).problem().solve()
    with pytest.raises(InputError, match=r"is an \.html file"):
        solution.report("result.pdf")
    with pytest.raises(InputError, match="list of ContactSolution"):
        solution.report("result.html", steps=[3])
    (comm.bcast(tmp_path) / "file").write_text("")
    with pytest.raises(InputError, match="cannot write"):
        solution.report(comm.bcast(tmp_path) / "file" / "result.html")
