"""The answer does not depend on the frame of reference, nor on the units."""

from __future__ import annotations

import numpy as np
import pytest
from rotations import rotation

from dolfinx_tresca import ContactStatus, Tresca
from dolfinx_tresca._base.parallel import reduce_array
from scenes.nodal import global_vector, nodal
from scenes.patches import KINDS, UPPER_BLOCK
from scenes.rubbing import BOUND, YOUNG, rubbing

#: Of the solver, and relative of the fields: a multiplier errs by the residual, which rounding
#: moves from frame to frame, times the condition number of A (below 1e3).
RTOL, SAME = 1e-12, 1e-9

#: The same where facets are quadrilaterals and no parallelograms: basis functions are then no
#: polynomials of the place, the quadrature errs by 1e-7 at most, and rounding decides into which
#: triangles an overlap is cut.
NEARLY_SAME = 1e-7

# cells, degree, distortion of the meshes, tolerance
SCENES = [
    *[(kind, degree, 0.3, SAME) for kind, degree in zip(KINDS[:3], (2, 1, 1), strict=True)],
    ("hexahedron", 1, 0.3, NEARLY_SAME),
]


def turn_of(kind):
    """A rotation, of the plane in 2D."""
    if kind in ("tetrahedron", "hexahedron"):
        return rotation(3)
    return np.array([[0.28, -0.96], [0.96, 0.28]])


def mirror_of(kind):
    """A reflection at a plane that is parallel to no side of the blocks."""
    normal = np.array([1.0, 2.0, -2.0]) / 3.0 if len(turn_of(kind)) == 3 else np.array([0.6, 0.8])
    return np.eye(len(normal)) - 2.0 * np.outer(normal, normal)


# for each frame: orthogonal matrix, shift, lengths, Young's modulus
FRAMES = {
    "turned": lambda kind: {"turn": turn_of(kind)},
    "moved": lambda kind: {"shift": (3.0, -2.0, 0.0 if len(turn_of(kind)) == 2 else 5.0)},
    "mirrored": lambda kind: {"turn": mirror_of(kind)},
    "millimetres": lambda kind: {"scale": 1e3},  # and N/mm^2 = MPa; MN become N
    "pascals": lambda kind: {"young": 1e9},
    "all": lambda kind: {"turn": mirror_of(kind), "scale": 1e3, "young": 1e9},
}


def solve(scene):
    with scene.problem() as problem:
        solution = problem.solve(rtol=RTOL)
    assert solution.status is ContactStatus.CONVERGED
    return solution


def fields_of(scene, solution, turn, shift, scale):
    """All fields on each rank, as vectors and values in the unmoved frame, sorted by places there.

    Partitions may differ from mesh to mesh.
    """
    comm, dim = scene.mesh.comm, scene.mesh.geometry.dim
    of_upper = scene.V.dofmap.list[scene.cell_tags.find(UPPER_BLOCK)].ravel()
    body = np.zeros(len(scene.V.tabulate_dof_coordinates()))
    body[of_upper] = 1.0  # two nodes at one place
    result = {}
    for field in ("u", "pressure", "traction", "slip", "gap", "state"):
        function = getattr(solution, field)
        values = nodal(function)
        places = function.function_space.tabulate_dof_coordinates()[: len(values)]
        places = (places - np.asarray(shift))[:, :dim] @ turn / scale
        on_body = body[: len(values)] if field == "u" else np.zeros(len(values))
        values = values @ turn if values.ndim == 2 else values
        result[field] = global_vector(comm, np.column_stack([places, on_body]), values)
    return result


@pytest.mark.parallel(kind=["quadrilateral", "tetrahedron"], degree=[1])
@pytest.mark.parametrize("kind, degree, distort, same", SCENES)
def test_the_frame_of_reference_does_not_matter(comm, kind, degree, distort, same):
    """Scenes that are turned, moved, mirrored or in other units have the same fields."""
    shape = {"upper": (4, 2), "lower": (6, 2), "distort": distort}
    dim = len(turn_of(kind))
    usual = {"turn": np.eye(dim), "shift": (0.0, 0.0, 0.0), "scale": 1.0}
    scene = rubbing(comm, kind, degree, **shape)
    here = solve(scene)
    assert 0 < here.counts.stick < here.counts.nodes
    assert 0 < here.counts.contact < here.counts.nodes
    fields = fields_of(scene, here, **usual)
    area = reduce_array(comm, here.surface.weights.sum())
    for name, frame in FRAMES.items():
        young = frame(kind).get("young", YOUNG)
        chosen = {**usual, **{key: v for key, v in frame(kind).items() if key != "young"}}
        law = Tresca(BOUND * young)
        scene = rubbing(comm, kind, degree, young=young, friction=law, **chosen, **shape)
        there = solve(scene)
        assert there.counts == here.counts, name
        # the last one, where residuals are 1e-10, may be a matter of rounding
        assert abs(there.iterations - here.iterations) <= 1, name
        assert abs(there.products - here.products) <= 1, name
        stress, length = young / YOUNG, chosen["scale"]
        units = {"u": length, "pressure": stress, "traction": stress, "slip": length, "gap": length}
        for field, found in fields_of(scene, there, **chosen).items():
            wanted = units.get(field, 1.0) * fields[field]
            difference = np.abs(found - wanted).max() / np.abs(wanted).max()
            assert difference <= same, (name, field)
        force, work = stress * length ** (dim - 1), stress * length**dim
        assert there.normal_force == pytest.approx(force * here.normal_force, rel=same)
        assert there.tangential_force == pytest.approx(force * here.tangential_force, rel=same)
        assert there.primal_energy == pytest.approx(work * here.primal_energy, rel=same)
        assert there.dual_energy == pytest.approx(work * here.dual_energy, rel=same)
        found = reduce_array(comm, there.surface.weights.sum())
        assert found == pytest.approx(length ** (dim - 1) * area, rel=same)
