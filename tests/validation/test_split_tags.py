"""A surface cut into tags, on either side, gives what one tag gives."""

from __future__ import annotations

import dataclasses
import logging

import numpy as np
import pytest
from logged import logged

import dolfinx
from dolfinx import fem

from dolfinx_tresca import (
    Bonded,
    ContactError,
    ContactForce,
    ContactPair,
    Coulomb,
    Frictionless,
    InputError,
    NormalForce,
    PairingError,
    Tresca,
)
from scenes.elasticity import elasticity, no_load
from scenes.patches import BOTTOM, LOWER, TOP, UPPER, patch
from scenes.scene import Scene

#: Relative difference of results that differ by rounding and the order of rows.
SAME = 1e-9

#: Tags of the parts of the upper and of the lower face.
PARTS = {UPPER: (21, 22, 23), LOWER: (31, 32)}


def pushed(comm, kind: str, degree: int = 1, **options) -> Scene:
    """Return two blocks, the upper one pushed down at one end more than at the other, and along."""
    sizes = {"upper": (4, 1), "lower": (3, 1)} | options
    scene = patch(comm, kind, degree, **sizes, distort=0.0)
    dim, V = scene.mesh.geometry.dim, scene.V
    push = fem.Function(V)
    push.interpolate(lambda x: np.stack([0.002 + 0 * x[0]] + [0 * x[0]] * (dim - 2)
                                        + [-0.01 * (1.0 - 0.3 * x[0])]))  # fmt: skip
    still = fem.Function(V)
    bcs = [
        fem.dirichletbc(value, fem.locate_dofs_topological(V, dim - 1, scene.facet_tags.find(tag)))
        for value, tag in ((push, TOP), (still, BOTTOM))
    ]
    return dataclasses.replace(scene, bcs=bcs, L=no_load(V), a=elasticity(V, 1000.0, 0.2))


def cut(scene: Scene, jagged: bool) -> object:
    """Return tags in which both faces are cut, along straight lines or lines with corners."""
    tags, mesh = scene.facet_tags, scene.mesh
    x = np.zeros((0, 3))
    if len(tags.indices):
        x = dolfinx.mesh.compute_midpoints(mesh, tags.dim, tags.indices)
    values = tags.values.copy()
    across = x[:, 1] if tags.dim == 2 else np.zeros(len(x))
    line = 0.45 + (0.3 * (across > 0.5) if jagged else 0.0)
    upper = np.where(x[:, 0] < line, 21, np.where(across > 0.6, 23, 22))
    lower = np.where(x[:, 0] < line - 0.2 * jagged, 31, 32)
    values = np.where(values == UPPER, upper, np.where(values == LOWER, lower, values))
    return dolfinx.mesh.meshtags(mesh, tags.dim, tags.indices, values.astype(np.int32))


def used(tags, part: int) -> bool:
    """Return whether a tag occurs on any rank."""
    return bool(tags.topology.comm.allreduce(len(tags.find(part))))


def split(scene: Scene, jagged: bool = True, sides=(UPPER, LOWER), **changes) -> list[ContactPair]:
    """Return the pairs between all parts of both sides; an uncut side is a list of tags."""
    tags = cut(scene, jagged)
    parts = [
        [part for part in PARTS[side] if used(tags, part)]
        if side in sides
        else [[part for part in PARTS[side] if used(tags, part)]]
        for side in (UPPER, LOWER)
    ]
    return [
        dataclasses.replace(scene.pair, facet_tags=tags, secondary=one, primary=other, **changes)
        for one in parts[0]
        for other in parts[1]
    ]


def facing(scene: Scene, pairs: list[ContactPair]) -> list[ContactPair]:
    """Return the pairs whose parts face each other."""
    found = []
    for pair in pairs:
        try:
            scene.operators(pair)
        except PairingError:
            continue
        found.append(pair)
    return found


def fields(comm, solution) -> dict[tuple[float, ...], np.ndarray]:
    """Return position -> pressure, traction, slip, gap and normal of all nodes with multipliers.

    The values must be the same in all pairs to which a node belongs.
    """
    result: dict[tuple[float, ...], np.ndarray] = {}
    for surface in solution.surfaces:
        own = surface.weights > 0.0
        columns = [surface.points]
        names = ["pressure", "gap", "traction", "slip"][: 4 if surface.traction else 2]
        for name in names:
            function = getattr(surface, name)
            size = function.function_space.dofmap.index_map_bs
            columns.append(function.x.array.reshape(-1, size))
        rows = np.hstack(columns)[own]
        for row in np.concatenate(comm.allgather(rows)):
            key = tuple(np.round(row[:3], 7) + 0.0)
            assert np.abs(result.get(key, row) - row).max() <= 1e-12
            result[key] = row
    return result


def agree(comm, one, other) -> None:
    """Compare all results of a pair with those of its parts."""
    assert other.status is one.status
    assert (other.iterations, other.products) == (one.iterations, one.products)
    assert other.counts == one.counts
    size = comm.allreduce(np.abs(one.u.x.array).max(initial=0.0))
    assert np.abs(other.u.x.array - one.u.x.array).max(initial=0.0) <= SAME * size
    for name in ("normal_force", "tangential_force", "dissipation", "peak_pressure", "dual_energy"):
        assert getattr(other, name) == pytest.approx(getattr(one, name), rel=SAME, abs=1e-14), name
    left, right = fields(comm, one), fields(comm, other)
    assert left.keys() == right.keys()
    scale = max(np.abs(row).max() for row in left.values())
    assert max(np.abs(left[x] - right[x]).max() for x in left) <= 10 * SAME * scale
    for name in ("force", "moment"):
        total = sum(getattr(part, name) for part in other.pair_resultants)
        whole = getattr(one.pair_resultants[0], name)
        assert np.abs(total - whole).max() <= SAME * max(np.abs(whole).max(), 1.0)
    areas = [comm.allreduce(sum(s.weights.sum() for s in found.surfaces)) for found in (one, other)]
    assert areas[1] == pytest.approx(areas[0], rel=SAME)


LAWS = {"none": Frictionless(), "Coulomb": Coulomb(0.3), "Tresca": Tresca(0.5), "tied": Bonded()}


@pytest.mark.parallel(kind=["triangle", "tetrahedron"], law=["Coulomb"])
@pytest.mark.parametrize(
    ("kind", "law"),
    [
        *(("triangle", "Coulomb"), ("quadrilateral", "none"), ("tetrahedron", "Tresca")),
        *(("hexahedron", "tied"), ("tetrahedron", "Coulomb")),
    ],
)
@pytest.mark.parametrize("sides", [(UPPER,), (LOWER,), (UPPER, LOWER)])
def test_pairs_between_parts_are_one_pair(comm, kind, law, sides):
    """Surfaces that are cut along lines with corners give what uncut ones give."""
    scene = pushed(comm, kind).but(friction=LAWS[law])
    pairs = facing(scene, split(scene, sides=sides))
    assert len(pairs) > 1
    with scene.problem() as whole, scene.problem(pairs=pairs) as parts:
        solution = parts.solve(rtol=1e-11)
        agree(comm, whole.solve(rtol=1e-11), solution)
        assert parts.contact_nodes == whole.contact_nodes
    with pytest.raises(ContactError, match=f"{len(pairs)} pairs"):
        _ = solution.pressure


@pytest.mark.parallel
@pytest.mark.parametrize(("sliding", "degree"), [("small", 1), ("finite", 1), ("finite", 2)])
def test_load_steps_goals_and_files(comm, folder, sliding, degree):
    """Load steps, restarts and derivatives are those of uncut surfaces."""
    found = []
    for name in ("whole", "parts"):
        scene = pushed(comm, "quadrilateral", degree)
        coefficient = fem.Constant(scene.mesh, 0.3)
        scene = scene.but(friction=Coulomb(coefficient), sliding=sliding)
        pairs = scene.pairs if name == "whole" else facing(scene, split(scene))
        push = scene.bcs[0]
        with scene.problem(pairs=pairs) as problem:
            problem.solve(rtol=1e-11).raise_if_failed()
            problem.accept()
            problem.save_state(folder / name)
        with scene.problem(pairs=pairs) as problem:
            problem.load_state(folder / name)
            push.g.x.array[:] *= 1.7
            if sliding == "finite":
                push.g.x.array[::2] += 0.2
            solution = problem.solve(rtol=1e-11)
            solution.raise_if_failed()
            gradients = []
            if sliding == "small":
                for goal in (NormalForce, lambda pair: ContactForce((1.0, 0.0), pair)):
                    rates = [problem.gradient(goal(k), [coefficient]) for k in range(len(pairs))]
                    gradients.append(sum(float(rate[0]) for rate in rates))
        found.append((solution, gradients))
    agree(comm, *(solution for solution, _ in found))
    assert found[1][1] == pytest.approx(found[0][1], rel=1e-6)


@pytest.mark.parallel
def test_a_list_of_tags_is_one_tag(comm):
    scene = pushed(comm, "hexahedron").but(friction=Coulomb(0.3))
    tags = cut(scene, jagged=True)
    lists = [[part for part in PARTS[side] if used(tags, part)] for side in (UPPER, LOWER)]
    pair = dataclasses.replace(scene.pair, facet_tags=tags, secondary=lists[0], primary=lists[1])
    with scene.problem() as whole, scene.problem(pairs=[pair]) as parts:
        agree(comm, whole.solve(rtol=1e-11), parts.solve(rtol=1e-11))
    with pytest.raises(InputError, match="between the surfaces"):
        scene.problem(pairs=[pair, dataclasses.replace(pair, secondary=22, primary=31)])
    with pytest.raises(InputError, match=r"\[22\] are on both sides"):
        ContactPair(tags, [21, 22], [22, 31], Frictionless())


@pytest.mark.parallel
@pytest.mark.parametrize(
    ("first", "second"),
    [(Tresca(0.2), Tresca(0.5)), (Frictionless(), Coulomb(0.3)), (Coulomb(0.3), Bonded())],
    ids=str,
)
def test_nodes_of_two_laws_follow_the_larger_bound(comm, caplog, first, second):
    """Nodes that belong to two laws follow the larger bound, and the log says so."""
    totals = []
    for reverse in (False, True):
        scene = pushed(comm, "quadrilateral")
        tags = cut(scene, jagged=False)
        pairs = [
            ContactPair(tags, part, [31, 32], law, name=f"part {part}")
            for part, law in ((21, first), (22, second))
        ][:: -1 if reverse else 1]
        caplog.clear()
        with caplog.at_level(logging.WARNING, logger="dolfinx_tresca"):
            problem = scene.problem(pairs=pairs)
        with problem:
            solution = problem.solve(rtol=1e-11)
        solution.raise_if_failed()
        if comm.rank == 0:
            assert logged(caplog).count(f"they follow the law of part 22, {second}") == 1
        totals.append((solution.normal_force, solution.tangential_force))
        at_seam = [
            row for x, row in fields(comm, solution).items() if np.isclose(x[0], 0.5, atol=1e-6)
        ]
        assert len(at_seam) == 1 and len(at_seam[0]) > 5
        gap, *shear = at_seam[0][4:8]
        if isinstance(second, Bonded):
            assert np.abs([gap, *at_seam[0][7:]]).max() <= 1e-9
        elif isinstance(second, Tresca):
            assert np.linalg.norm(shear[:2]) == pytest.approx(0.5, rel=1e-6)
    assert totals[1] == pytest.approx(totals[0], rel=1e-8)


@pytest.mark.parallel
def test_pairs_on_common_nodes_must_slide_alike(comm):
    scene = pushed(comm, "triangle")
    tags = cut(scene, jagged=False)
    pairs = [ContactPair(tags, 21, 31, Frictionless(), sliding="finite"),
             ContactPair(tags, 22, 32, Frictionless())]  # fmt: skip
    with pytest.raises(InputError, match="differ in sliding"):
        scene.problem(pairs=pairs)
    other = dolfinx.mesh.meshtags(scene.mesh, tags.dim, tags.indices, tags.values)
    pairs = [ContactPair(tags, 21, 31, Frictionless()), ContactPair(other, 22, 32, Frictionless())]
    with pytest.raises(InputError, match="differ in facet_tags"):
        scene.problem(pairs=pairs)
