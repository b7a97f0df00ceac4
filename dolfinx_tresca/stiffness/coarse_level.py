"""The level of degree 1 below a space of degree 2, for p-multigrid."""

from __future__ import annotations

from typing import Any

from petsc4py import PETSc

import numpy as np

import dolfinx.fem.petsc
from dolfinx import fem

from dolfinx_tresca._base.arrays import Mask


def add_degree_1(pc: PETSc.PC, K: PETSc.Mat, V: Any, prescribed: Mask) -> None:
    """Make a preconditioner multigrid with two levels: V, and that of degree 1 on its mesh.

    Collective. The coarse matrix is P'KP, with the interpolation P between the spaces: what the
    form gives there, as degree 1 is within degree 2, but without compiling one more form, and with
    all that K has besides, such as the springs of floating bodies; it takes as long.

    Args:
        pc: of a KSP whose matrix is K.
        K: rows and columns that are prescribed are those of the identity.
        V: of degree 2.
        prescribed: (owned degrees of freedom,) bool.
    """
    coarse = fem.functionspace(V.mesh, ("Lagrange", 1, (V.dofmap.index_map_bs,)))
    P = dolfinx.fem.petsc.interpolation_matrix(coarse, V)
    P.assemble()
    fine_free, free = _free(V, coarse, prescribed)
    # with one of the two left out corrections spoil prescribed values: many times the iterations
    P.diagonalScale(fine_free.x.petsc_vec, free.x.petsc_vec)
    product = K.ptap(P)
    K1 = product.copy()  # without what would make the product anew, which is larger than itself
    product.destroy()
    first, last = K1.getOwnershipRange()
    held = first + np.flatnonzero(free.x.array[: last - first] == 0.0)
    K1.zeroRowsColumns(held.astype(PETSc.IntType), 1.0)
    K1.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    set_rigid_body_modes(K1, coarse)
    pc.setType(PETSc.PC.Type.MG)
    pc.setMGLevels(2)
    pc.setMGInterpolation(1, P)
    pc.getMGCoarseSolve().setOperators(K1)
    P.destroy()
    K1.destroy()


def _free(V: Any, coarse: Any, prescribed: Mask) -> tuple[fem.Function, fem.Function]:
    """Return functions in two spaces that are 0 where u is prescribed, else 1. Collective."""
    free, coarse_free = fem.Function(V), fem.Function(coarse)
    free.x.array[: len(prescribed)] = ~prescribed
    free.x.scatter_forward()
    coarse_free.interpolate(free)
    coarse_free.x.array.round(out=coarse_free.x.array)
    coarse_free.x.scatter_forward()
    return free, coarse_free


def set_rigid_body_modes(K: PETSc.Mat, V: Any) -> None:
    """Make the rigid body modes the near-nullspace of a matrix on a space. Collective.

    They are the motions of all of space: on each body they are its own, so one set serves any
    number of bodies.
    """
    nodes, dim = V.dofmap.index_map, V.mesh.geometry.dim
    points = PETSc.Vec().createMPI(
        (dim * nodes.size_local, dim * nodes.size_global), bsize=dim, comm=K.comm
    )
    points.array = V.tabulate_dof_coordinates()[: nodes.size_local, :dim].ravel()
    near_nullspace = PETSc.NullSpace().createRigidBody(points)
    K.setNearNullSpace(near_nullspace)
    near_nullspace.destroy()
    points.destroy()
