"""Forces that balance, and the contact and friction laws, on meshes that match or do not."""

from __future__ import annotations

import numpy as np
import pytest

import dolfinx
import ufl
from dolfinx import fem

from dolfinx_tresca import ContactStatus
from dolfinx_tresca._base.parallel import reduce_array
from scenes.nodal import global_vector, surface_nodes_of
from scenes.patches import BOTTOM, KINDS, TOP, UPPER_BLOCK
from scenes.rubbing import rubbing

RTOL = 1e-10

#: Of sums of forces, over the largest of them: rounding in the solution with K.
BALANCE = 1e-10


#: Kind of the cells, degree, and pairing of the nodes: the meshes match for the first kind only.
SCENES = [("tetrahedron", 1, "nodes")]
SCENES += [(kind, degree, "mortar") for kind in KINDS for degree in (1, 2)]
ON_RANKS = [SCENES[0], *((*one, "mortar") for one in ((KINDS[0], 2), (KINDS[2], 1), (KINDS[3], 1)))]


@pytest.fixture(params=SCENES, ids=lambda scene: "-".join(map(str, scene)))
def solved(comm, request):
    """A scene with sticking, slipping and open nodes, solved."""
    kind, degree, pairing = request.param
    lower = {"lower": (6, 3)} if pairing == "mortar" else {"lower": (4, 2), "distort": 0.0}
    scene = rubbing(comm, kind, degree, upper=(4, 2), pairing=pairing, **lower)
    with scene.problem() as problem:
        solution = problem.solve(rtol=RTOL)
    assert solution.status is ContactStatus.CONVERGED
    counts = solution.counts
    assert 0 < counts.contact < counts.nodes
    assert 0 < counts.stick < counts.nodes
    return scene, solution


def nodal_forces(scene, u):
    """K u - f (n, dim) at this rank's nodes: support and contact are what is left."""
    vector = fem.assemble_vector(fem.form(ufl.action(scene.a, u) - scene.L))
    vector.scatter_reverse(dolfinx.la.InsertMode.add)
    n, dim = scene.V.dofmap.index_map.size_local, scene.mesh.geometry.dim
    return vector.array[: n * dim].reshape(n, dim)


def resultant(points, forces):
    """Sum and moment about the origin (6,) of forces (n, dim)."""
    full = np.zeros((len(forces), 3))
    full[:, : forces.shape[1]] = forces
    return np.concatenate([full.sum(axis=0), np.cross(points, full).sum(axis=0)])


def everywhere(comm, solution):
    """Points, weights and fields of all contact nodes, on each rank."""
    points, fields = surface_nodes_of(solution)
    found = {name: global_vector(comm, points, values) for name, values in fields.items()}
    return global_vector(comm, points, points), found.pop("weights"), found


@pytest.mark.parallel(solved=ON_RANKS)
def test_reactions_and_contact_forces_balance(solved):
    """Forces and moments of blocks, supports and contact balance, and are those reported."""
    scene, solution = solved
    comm, dim = scene.mesh.comm, scene.mesh.geometry.dim
    forces = nodal_forces(scene, solution.u)
    points = scene.V.tabulate_dof_coordinates()[: len(forces)]
    upper, held = np.zeros((2, len(forces)), dtype=bool)
    of_upper = scene.V.dofmap.list[scene.cell_tags.find(UPPER_BLOCK)].ravel()
    upper[of_upper[of_upper < len(forces)]] = True
    for tag in (TOP, BOTTOM):
        own = fem.locate_dofs_topological(scene.V, dim - 1, scene.facet_tags.find(tag))
        held[own[own < len(forces)]] = True

    def total(part):
        return reduce_array(comm, resultant(points[part], forces[part]))

    reaction = total(held & upper)
    size = np.abs(reaction).max()
    assert np.abs(reaction + total(held & ~upper)).max() <= BALANCE * size
    # the contact has no force and no moment of its own, and each side's is what its support takes
    assert np.abs(reaction + total(~held & upper)).max() <= BALANCE * size
    assert np.abs(reaction - total(~held & ~upper)).max() <= BALANCE * size

    # pressure and traction act on the upper block with their sign changed; its outward normal is
    # against the axis
    places, weights, fields = everywhere(comm, solution)
    stress = fields["traction"] - fields["pressure"][:, None] * scene.data.axis[:dim]
    contact = resultant(places, weights[:, None] * stress)
    assert np.abs(contact - reaction)[:3].max() <= BALANCE * size
    components = [*range(dim), 5] if dim == 2 else range(6)
    on_lower, on_upper = solution.body_resultants
    # all moments have the same point unless another one is given
    between = solution.resultants_between(0, 1)
    np.testing.assert_array_equal(between.point, on_lower.point)
    np.testing.assert_array_equal(solution.resultants()[0].point, on_lower.point)
    assert np.abs(between.force - on_lower.force).max() <= BALANCE * size
    assert np.abs(between.moment - on_lower.moment).max() <= BALANCE * size
    for one in (*solution.resultants(np.zeros(dim)), on_upper.about(np.zeros(dim))):
        found = np.concatenate([one.force, one.moment])
        assert np.abs(found + reaction[components]).max() <= BALANCE * size
    assert np.abs(on_lower.force + on_upper.force).max() <= BALANCE * size
    assert np.abs(on_lower.moment + on_upper.moment).max() <= BALANCE * size
    normal = float(reaction[:3] @ -scene.data.axis)
    tangential = reaction[:3] + normal * scene.data.axis
    assert solution.normal_force == pytest.approx(normal, abs=BALANCE * size)
    assert solution.tangential_force == pytest.approx(
        np.linalg.norm(tangential), abs=BALANCE * size
    )
