"""Secondary cells are refined with those that they hold."""

from __future__ import annotations

import numpy as np
import pytest
from test_scenes import several_bodies, stack
from test_solve import cantilever, sheet

import dolfinx
from dolfinx import fem

from dolfinx_tresca import InputError, solve_adaptively
from dolfinx_tresca.adapt.solve import refinement_indicators
from scenes.patches import LOWER, LOWER_BLOCK, UPPER, UPPER_BLOCK, patch
from scenes.pressed_blocks import on_blocks, pressed_blocks
from scenes.scene import EPS


def cells_at(scene, tag):
    """Return the cells of facets of a scene or a TaggedMesh, those of this rank."""
    mesh = scene.mesh
    dim = mesh.topology.dim
    facets = scene.facet_tags.find(tag)
    cells = dolfinx.mesh.compute_incident_entities(mesh.topology, facets, dim - 1, dim)
    return cells[cells < mesh.topology.index_map(dim).size_local]


def errors_of(scene, **values):
    """Return a function with errors of the cells of each block, and of those at its contact."""
    errors = fem.Function(fem.functionspace(scene.mesh, ("DG", 0)))
    for name, tag, block in (("upper", UPPER, UPPER_BLOCK), ("lower", LOWER, LOWER_BLOCK)):
        errors.x.array[scene.cell_tags.find(block)] = 0.1 * values[name]
        errors.x.array[cells_at(scene, tag)] = values[name]
    errors.x.scatter_forward()
    return errors


@pytest.mark.parallel
@pytest.mark.parametrize(
    ("kind", "degree", "pairing"),
    [("triangle", 1, "mortar"), ("triangle", 2, "mortar"), ("tetrahedron", 2, "mortar"),
     ("triangle", 1, "nodes")],
)  # fmt: skip
def test_a_cell_has_the_errors_of_all_before_it(comm, kind, degree, pairing):
    """In squares; that is as many as there are facets before its own."""
    dim = 2 if kind == "triangle" else 3
    finer = 2 if pairing == "mortar" else 1
    scene = patch(
        comm, kind, degree, upper=(2, 1), lower=(2 * finer, 1), distort=0.0, pairing=pairing
    )
    with scene.problem() as problem:
        for secondary in (0.5, 10.0):
            errors = errors_of(scene, upper=secondary, lower=1.0)
            before = errors.x.array.copy()
            raised = refinement_indicators(problem, errors)
            assert np.array_equal(errors.x.array, before)
            at = cells_at(scene, UPPER)
            before[at] = max(secondary, finer ** ((dim - 1) / 2))
            owned = scene.mesh.topology.index_map(dim).size_local
            assert np.allclose(raised.x.array[:owned], before[:owned], rtol=1e4 * EPS)


@pytest.mark.parallel
def test_each_pair_counts_by_itself(comm):
    """Of three bodies the lowest has errors: the one on it gets them, and hands nothing on."""
    bodies = stack(comm)
    with several_bodies(bodies) as problem:
        errors = fem.Function(fem.functionspace(bodies.mesh, ("DG", 0)))
        errors.x.array[cells_at(bodies, bodies.tags["top_2"])] = 1.0
        errors.x.scatter_forward()
        raised = refinement_indicators(problem, errors)
    expected = errors.x.array.copy()
    expected[cells_at(bodies, bodies.tags["bottom_1"])] = 1.0
    owned = bodies.mesh.topology.index_map(2).size_local
    assert np.allclose(raised.x.array[:owned], expected[:owned], atol=10 * EPS**0.5)


@pytest.mark.parallel
def test_obstacles_have_no_errors(comm):
    with cantilever(sheet(comm)) as problem:
        errors = problem.solve().cell_errors
        raised = refinement_indicators(problem, errors)
        for wrong, message in (
            (None, "cell_errors is None"),
            (errors.x.array, "cell_errors (must be|differs)"),
        ):
            with pytest.raises(InputError, match=message):
                refinement_indicators(problem, wrong)
    assert np.array_equal(raised.x.array, errors.x.array)


@pytest.mark.parallel
def test_a_stiff_side_is_as_fine_as_the_soft_one_it_holds(comm):
    """It has next to no errors of its own; two facets held seventeen before."""
    narrow, lower = pressed_blocks(comm, 4, narrow=True).tagged_mesh, 0.01
    result = solve_adaptively(
        lambda tagged: on_blocks(tagged, lower=lower).problem(), narrow, 1e-3, max_levels=6
    )
    last = on_blocks(result.tagged_mesh, lower=lower)
    own, before = (comm.allreduce(len(cells_at(last, tag))) for tag in (UPPER, LOWER))
    assert before >= 10
    assert own >= before / 3
