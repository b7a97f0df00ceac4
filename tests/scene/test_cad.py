"""What comes from CAD files and from Gmsh's models: names, sizes, geometry, and errors."""

from __future__ import annotations

from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest

import ufl
from dolfinx import fem

from dolfinx_tresca import Frictionless, InputError, MeshError, contacts, read_gmsh
from dolfinx_tresca._base import compat

gmsh = pytest.importorskip("gmsh")

SIZE = 4.0


@pytest.fixture
def session():
    """A session of Gmsh of the user, on each rank."""
    gmsh.initialize(interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    yield gmsh.model
    gmsh.finalize()


@pytest.fixture
def folder(comm, tmp_path):
    return comm.bcast(tmp_path, root=0)


def pin_in_plate(occ, play=0.05):
    plate, hole = occ.addBox(-10, -10, 0, 20, 20, 5), occ.addCylinder(0, 0, 0, 0, 0, 5, 5)
    occ.cut([(3, plate)], [(3, hole)])
    occ.addCylinder(0, 0, -2, 0, 0, 9, 5 - play)
    occ.synchronize()


def curved_names(tagged) -> set[str]:
    curved = tagged.geometry.curved
    return {name for name, tag in tagged.tags.items() if tag in curved and "/" in name}


def volume(tagged) -> float:
    one = fem.Constant(tagged.mesh, 1.0)
    return tagged.mesh.comm.allreduce(fem.assemble_scalar(fem.form(one * ufl.dx)))


@pytest.mark.parallel
def test_bodies_have_the_names_of_their_labels(comm, folder, session):
    """Faces too, if they have one; names that occur twice are numbered."""
    path = folder / "assembly.step"
    if comm.rank == 0:
        pin_in_plate(session.occ)
        gmsh.write(str(path))
        text = path.read_text()
        for name in ("plate", "pin"):  # the products, in their order, after that of the assembly
            start = text.index("PRODUCT('Open CASCADE STEP translator", text.index("PRODUCT('") + 9)
            end = text.index("(#", start)
            text = f"{text[:start]}PRODUCT('{name}','{name}','',{text[end:]}"
        path.write_text(text)
    comm.barrier()
    tagged = read_gmsh(path, comm, size=SIZE)
    assert set(tagged.cell_tags.names.values()) == {"plate", "pin"}
    assert {"plate/1", "pin/1", "pin/3"} <= set(tagged.tags)
    assert tagged.cell_tags.names[tagged.tags["pin"]] == "pin"
    assert len(curved_names(tagged)) == 2
    (pair,) = contacts(tagged, friction=Frictionless())
    assert str(pair) == "pin/1 on plate/7"


@pytest.mark.parallel
def test_the_geometry_of_a_model_is_known(comm, session):
    """Of shapes that the kernel has renumbered; a mesh that DOLFINx has made has names only."""
    if comm.rank == 0:
        pin_in_plate(session.occ)
    tagged = read_gmsh(gmsh.model, comm, size=SIZE)
    data = compat._gmsh_reader.model_to_mesh(gmsh.model, comm, 0)
    plain = read_gmsh(data, comm)
    assert abs(volume(tagged) - volume(plain)) <= 1e-9 * volume(plain)
    assert plain.geometry is None
    if hasattr(data, "physical_groups"):  # since DOLFINx 0.10
        assert plain.tags == tagged.tags
    assert len(tagged.geometry.curved) == 2
    found = contacts(tagged, friction=Frictionless(), sliding="finite")
    (measures,) = found.measures.values()
    assert found[0].sliding == "finite" and "gap 0.05" in str(found)
    assert abs(measures.gap - 0.05) <= 1e-5
    area = 2 * np.pi * 5 * 5
    assert abs(measures.area - area) <= 0.02 * area
    if comm.rank == 0:
        assert len(session.getEntities(3)) == 2  # the user's model is still there


def test_a_file_in_metres_and_one_in_millimetres_are_the_same(tmp_path, session):
    """STEP files name their unit, so the mesh has the unit that is asked for."""
    sizes = {}
    for unit in ("M", "MM"):
        gmsh.clear()
        session.occ.addBox(0, 0, 0, *((10, 20, 30) if unit == "MM" else (0.01, 0.02, 0.03)))
        session.occ.synchronize()
        gmsh.write(str(tmp_path / f"{unit}.step"))
        if unit == "M":
            path = tmp_path / "M.step"
            text = path.read_text()
            path.write_text(text.replace("SI_UNIT(.MILLI.,.METRE.)", "SI_UNIT($,.METRE.)"))
        tagged = read_gmsh(tmp_path / f"{unit}.step", MPI.COMM_SELF, size=10)
        sizes[unit] = volume(tagged)
    assert np.allclose(list(sizes.values()), 6000.0, rtol=1e-6)
    metres = read_gmsh(tmp_path / "MM.step", MPI.COMM_SELF, size=0.01, unit="m")
    assert np.isclose(volume(metres), 6000e-9, rtol=1e-6)


def test_cells_are_finer_where_bodies_are_near(session):
    session.occ.addBox(0, 0, 0, 20, 20, 20)
    session.occ.addBox(0, 0, 20.1, 20, 20, 20)
    session.occ.synchronize()
    tagged = read_gmsh(gmsh.model, MPI.COMM_SELF, size={"body 1": 5.0, "body 2": 8.0})
    mesh, tags = tagged.mesh, tagged.facet_tags
    h = {name: mesh.h(2, tags.find(tag)).mean() for name, tag in tagged.tags.items() if "/" in name}
    assert h["body 1/6"] < 0.75 * h["body 1/5"] and h["body 2/5"] < 0.75 * h["body 2/6"]
    assert h["body 1/5"] < 0.8 * h["body 2/6"]


def shell(occ):
    occ.addBox(0, 0, 0, 1, 1, 1)
    occ.remove([(3, 1)])
    occ.remove([(2, 6)])


def shell_beside_a_body(occ):
    occ.addBox(0, 0, 0, 1, 1, 1)
    occ.addDisk(5, 0, 0, 1, 1)


def merged(occ):
    occ.addBox(0, 0, 0, 1, 1, 1)
    occ.addBox(0, 0, 1, 1, 1, 1)
    occ.fragment([(3, 1)], [(3, 2)])


def apart(occ):
    occ.addBox(0, 0, 0, 1, 1, 1)
    occ.addBox(0, 0, 3.5, 1, 1, 1)


def overlapping_faces(occ):
    """A box, and inside its faces a smaller one: the surfaces of one solid that cross."""
    wires = [
        occ.addCurveLoop(
            [occ.addLine(a, b) for a, b in zip(loop, (*loop[1:], loop[0]), strict=True)]
        )
        for loop in ([occ.addPoint(*xy, 0) for xy in ((0, 0), (2, 2), (2, 0), (0, 2))],)
    ]  # a bow tie
    occ.extrude([(2, occ.addPlaneSurface(wires))], 0, 0, 1)


def in_metres(occ):
    occ.addBox(0, 0, 0, 1, 1, 1)
    occ.addBox(0, 0, 1e-3, 1e-3, 1e-3, 1e-3)
    occ.translate([(3, 2)], 1.5, 0, 0)


WRONG = {
    "an open shell": (shell, {}, MeshError, "5 faces and no solid"),
    "a loose face": (shell_beside_a_body, {}, MeshError, "1 of the 7 faces .* belong to no body"),
    "one face for two bodies": (merged, {}, MeshError, "body 1 and body 2 .* share a face"),
    "parts apart": (
        apart,
        {},
        MeshError,
        "body 1/1, .* touch no other body: their box is 2.5 away",
    ),
    "faces that cross": (overlapping_faces, {}, MeshError, "Faces of a body that overlap or cross"),
    "one body in metres": (in_metres, {"size": {"body 1": 0.5}}, MeshError, "units of length of"),
    "a size": (apart, {"size": -1.0}, InputError, "must be a positive number, found -1.0"),
    "a body": (apart, {"size": {"pin": 1.0}}, InputError, "no body 'pin'; its bodies are body 1"),
    "a unit": (apart, {"unit": "mile"}, InputError, "unit must be one of mm, "),
    "a parameter": (apart, {"N": 3}, InputError, "takes no parameters"),
}


@pytest.mark.parallel(name=["an open shell", "parts apart"])
@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_named(comm, folder, session, name):
    shapes, options, kind, message = WRONG[name]
    path = folder / "wrong.brep"
    if comm.rank == 0:
        shapes(session.occ)
        session.occ.synchronize()
        gmsh.write(str(path))
    comm.barrier()
    with pytest.raises(kind, match=message):
        contacts(read_gmsh(path, comm, **{"size": 0.5, **options}), friction=Frictionless())


def test_a_body_beside_the_others_is_warned_of(session, caplog):
    for z in (0, 1, 5):
        session.occ.addBox(0, 0, z, 1, 1, 1)
    session.occ.synchronize()
    tagged = read_gmsh(gmsh.model, MPI.COMM_SELF, size=0.5)
    assert len(contacts(tagged, friction=Frictionless(), distance=0.1)) == 1
    text = " ".join(caplog.text.split())
    assert "body 3/1, body 3/2, body 3/3, 3 more touch no other body: their box is 3 away" in text
    single = compat.with_values(tagged.facet_tags, np.ones_like(tagged.facet_tags.values))
    with pytest.raises(MeshError, match="need tags of two bodies"):
        contacts(replace(tagged, facet_tags=single), friction=Frictionless())
