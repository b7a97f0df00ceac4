"""ContactOperators: use with other solvers and for other fields."""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import clarabel
import numpy as np
import pytest
from conic import conic_minimum
from scipy.sparse import block_diag, csr_array, hstack, vstack

import ufl
from dolfinx import fem
from dolfinx.fem.petsc import apply_lifting, assemble_matrix, assemble_vector, set_bc

from dolfinx_tresca import Tresca
from scenes.assembled import direct_solver, on_one_rank
from scenes.nodal import nodal
from scenes.patches import BOTTOM, TOP, patch
from scenes.rubbing import rubbing
from scenes.scene import EPS

BOUND = 0.3

#: Rounding of sums of integrals over some hundred facets.
ROUNDING = 1e4 * EPS


def test_a_conic_solver_finds_the_same_contact():
    """Clarabel minimises 1/2 u'K u - f'u + sum of w g |T u| subject to N u <= gap.

    Its unknowns are u and s >= |T u| at each node; Dirichlet conditions are constraints.
    """
    scene = rubbing(MPI.COMM_SELF, "tetrahedron", friction=Tresca(BOUND))
    with scene.problem() as problem:
        solution = problem.solve(rtol=1e-8)
        (one,) = problem.operators
        K, N, T = (on_one_rank(matrix) for matrix in (problem.stiffness, one.N, one.T))
        f, dofs = problem.load.array.copy(), np.flatnonzero(problem.prescribed)
        n, m, k = K.shape[0], len(one.gap), len(one.nodes)
        fixed = csr_array((np.ones(len(dofs)), (np.arange(len(dofs)), dofs)), (len(dofs), n))
        order = np.argsort(one.tangent_node, kind="stable")
        assert (np.bincount(one.tangent_node) == 2).all()
        # the rows of the second-order cone (s, T u) of each node are consecutive
        cones = vstack(
            [
                hstack([csr_array((k, n)), -csr_array(np.eye(k))]),
                hstack([-T[order], csr_array((2 * k, k))]),
            ]
        )
        cones = cones.tocsr()[
            np.stack([np.arange(k), k + 2 * np.arange(k), k + 2 * np.arange(k) + 1], axis=1).ravel()
        ]
        left = [hstack([fixed, csr_array((len(dofs), k))]), hstack([N, csr_array((m, k))]), cones]
        right = [f[dofs], one.gap, np.zeros(3 * k)]
        kinds = [clarabel.ZeroConeT(len(dofs)), clarabel.NonnegativeConeT(m)]
        kinds += [clarabel.SecondOrderConeT(3)] * k
        cost = np.concatenate([-f, BOUND * one.weights])
        P = block_diag([K, csr_array((k, k))])
        found = conic_minimum(P, cost, left, right, kinds, tolerance=1e-11)
    u = solution.u.x.array
    assert np.abs(np.array(found.x)[:n] - u).max() <= 1e-5 * np.abs(u).max()
    forces = np.array(found.z)[len(dofs) : len(dofs) + m]
    assert forces.sum() == pytest.approx(solution.normal_force, rel=1e-5)


@pytest.mark.parallel
@pytest.mark.parametrize(("kind", "degree"), [("triangle", 2), ("tetrahedron", 1)])
def test_operators_and_contact_force(comm, kind, degree):
    """The gap of the solution is gap - N u; the contact force at free dofs is K u - f."""
    scene = patch(comm, kind, degree, upper=(3, 1), lower=(2, 1), friction=Tresca(BOUND))
    scene.data.exact.x.array[:] *= 1.0 + 0.3 * np.sin(np.arange(len(scene.data.exact.x.array)))
    scene.data.exact.x.scatter_forward()
    with scene.problem() as problem:
        solution = problem.solve(rtol=1e-10)
        (one,) = problem.operators
        u, force = solution.u, solution.contact_force
        jump = one.N.createVecLeft()
        one.N.mult(u.x.petsc_vec, jump)
        gap = np.zeros(len(one.nodes))
        gap[one.normal_node] = one.gap - jump.array
        size = comm.allreduce(np.abs(u.x.array).max(), op=MPI.MAX)
        p, t = solution.multipliers[: len(one.gap)], solution.multipliers[len(one.gap) :]
        total = one.N.createVecRight()
        pressed, dragged = one.N.createVecLeft(), one.T.createVecLeft()
        pressed.array = one.weights[one.normal_node] * p
        dragged.array = one.weights[one.tangent_node] * t
        one.N.multTranspose(pressed, total)
        one.T.multTransposeAdd(dragged, total, total)
        largest = comm.allreduce(np.abs(force.x.array).max(), op=MPI.MAX)
        owned = len(problem.prescribed)
        assert np.abs(force.x.array[:owned] + total.array).max() <= 1e-12 * largest

        residual = problem.stiffness * u.x.petsc_vec - problem.load
        rest = np.where(problem.prescribed, 0.0, residual.array - force.x.array[:owned])
        assert np.abs(rest).max() <= 1e-8 * largest
        shown = solution.gap.x.array
        least = comm.allreduce(gap.min(initial=0.0), op=MPI.MIN)
        assert least == pytest.approx(
            comm.allreduce(shown.min(initial=0.0), op=MPI.MIN), abs=1e-12 * size
        )


@pytest.mark.parallel
@pytest.mark.parametrize(
    ("kind", "upper", "lower"),
    [
        ("quadrilateral", (3, 1), (2, 1)),
        ("triangle", (5, 2), (3, 4)),
        ("tetrahedron", (2, 1), (3, 2)),
    ],
)
def test_coupled_heat_on_unrelated_meshes(comm, kind, upper, lower):
    """Two blocks of height 1 and conductivity 1 conduct heat between two temperatures.

    The contact conserves heat to rounding for any h. For constant h the resistances are 1, 1/h and
    1, and temperatures are linear on any meshes.
    """
    scene = patch(comm, kind, upper=upper, lower=lower)
    mesh, axis = scene.mesh, scene.mesh.geometry.dim - 1
    Q = fem.functionspace(mesh, ("Lagrange", 1))
    test, trial = ufl.TestFunction(Q), ufl.TrialFunction(Q)
    heat = fem.form(ufl.inner(ufl.grad(trial), ufl.grad(test)) * ufl.dx)
    no_source = fem.form(fem.Constant(mesh, 0.0) * test * ufl.dx)
    ends, top = fem.Function(Q), 10.0
    ends.interpolate(lambda x: top / 2 * x[axis])
    facets = np.sort(np.concatenate([scene.facet_tags.find(tag) for tag in (TOP, BOTTOM)]))
    bcs = [fem.dirichletbc(ends, fem.locate_dofs_topological(Q, axis, facets))]
    T, h, given = fem.Function(Q), fem.Function(Q), []
    for wave in (3.0, 0.0):
        h.interpolate(lambda x, wave=wave: 4.0 + wave * np.sin(5.0 * x[0]))
        with scene.problem() as problem:
            C = problem.operators[0].conductance_matrix(h)
        K, b = assemble_matrix(heat, bcs=bcs), assemble_vector(no_source)
        K.assemble()
        apply_lifting(b, [heat], [bcs])
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        set_bc(b, bcs)
        solver = direct_solver(K + C)
        solver.solve(b, T.x.petsc_vec)
        flow = (C * T.x.petsc_vec).array
        given = comm.allreduce(np.array([flow.sum(), np.abs(flow).sum() / 2]))
        assert abs(given[0]) <= ROUNDING * given[1]
        for owned in (solver, C, K, b):
            owned.destroy()
    q = top / (2.0 + 1.0 / 4.0)
    assert given[1] == pytest.approx(q, rel=ROUNDING)
    height = Q.tabulate_dof_coordinates()[: len(flow), axis]
    above = (height > 1.0 + ROUNDING) | (flow > ROUNDING)  # heat leaves the upper side
    wanted = np.where(above, top - q * (2.0 - height), q * height)
    assert np.abs(nodal(T) - wanted).max(initial=0.0) <= ROUNDING * top
