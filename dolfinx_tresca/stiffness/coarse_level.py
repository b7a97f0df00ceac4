"""Multigrid levels below a space: degree 1 below degree 2, coarser meshes below a refined mesh."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from petsc4py import PETSc

import numpy as np

import dolfinx.fem.petsc
from dolfinx import fem

from dolfinx_tresca._base.arrays import Mask
from dolfinx_tresca.stiffness.nested import is_nested, nested


def has_levels(V: Any) -> bool:
    """Return whether a space has multigrid levels below it: degree 1, or coarser meshes.

    Not collective.
    """
    return V.element.basix_element.degree > 1 or is_nested(V)


def _spaces(V: Any) -> Iterator[tuple[Any, PETSc.Mat]]:
    """Yield the spaces below V, each with its interpolation to the finer space. Collective."""
    if V.element.basix_element.degree > 1:
        linear_space = fem.functionspace(V.mesh, ("Lagrange", 1, (V.dofmap.index_map_bs,)))
        P = dolfinx.fem.petsc.interpolation_matrix(linear_space, V)
        P.assemble()
        yield linear_space, P
        V = linear_space
    yield from nested(V)


def add_levels(pc: PETSc.PC, K: PETSc.Mat, V: Any, prescribed: Mask) -> None:
    """Set up a preconditioner as multigrid with the spaces below V as its levels. Collective.

    The matrices of the levels are P'KP, with the interpolation P between the spaces. They need no
    further compiled forms, and include additions to K, such as the springs of floating bodies.
    Apart from such additions, P'KP equals the matrix of the form on the coarser space, since the
    coarser space is a subspace, except at nodes that were moved to curved surfaces.

    Args:
        pc: preconditioner of a KSP whose matrix is K.
        K: the matrix, with identity rows and columns for prescribed values.
        V: a space with levels below it.
        prescribed: (owned degrees of freedom,) whether each is prescribed.
    """
    free = K.createVecLeft()
    free.array = ~prescribed
    matrices, interpolations = [K], []
    for coarse, P in _spaces(V):
        coarse_free = _injected(P, free)
        # if either scaling is left out, corrections change prescribed values, and far more
        # iterations are needed
        P.diagonalScale(free, coarse_free)
        free.destroy()
        free = coarse_free
        product = matrices[-1].ptap(P)
        below = product.copy()  # drops data for further products, which are larger than the matrix
        product.destroy()
        start, _ = below.getOwnershipRange()
        held = start + np.flatnonzero(free.array == 0.0)
        below.zeroRowsColumns(held.astype(PETSc.IntType), 1.0)
        below.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        matrices.append(below)
        interpolations.append(P)
        lowest = coarse
    free.destroy()
    set_rigid_body_modes(matrices[-1], lowest)
    pc.setType(PETSc.PC.Type.MG)
    pc.setMGLevels(len(matrices))
    for level, P in enumerate(reversed(interpolations), start=1):
        pc.setMGInterpolation(level, P)
        P.destroy()
    for level, matrix in enumerate(reversed(matrices[1:])):
        pc.getMGSmoother(level).setOperators(matrix)
        matrix.destroy()


def _injected(P: PETSc.Mat, values: PETSc.Vec) -> PETSc.Vec:
    """Return a mask at the nodes of a coarse space from a mask at the nodes of a finer space.

    The nodes of the coarse space are nodes of the finer space, too. The result is rounded, since P
    is not exact. Collective.

    Args:
        P: interpolation from the coarse space to the finer one, with ones in the rows of the common
            nodes and smaller entries elsewhere.
        values: 0 or 1 at the nodes of the finer space.
    """
    ones = P.copy()
    ones.chop(0.99)
    result = ones.createVecRight()
    ones.multTranspose(values, result)
    ones.destroy()
    result.array = result.array.round()
    return result


def set_rigid_body_modes(K: PETSc.Mat, V: Any) -> None:
    """Tell GAMG the rigid body modes, as the near-nullspace of a matrix on a space. Collective.

    Each mode moves all bodies together as one rigid body, so it is a rigid motion of each body,
    too: one set of modes serves any number of bodies.
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
