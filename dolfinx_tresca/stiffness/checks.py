"""Checks of a mesh and of an assembled stiffness matrix, with errors that say what to change."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_tresca._base.arrays import Mask
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca.errors import InputError, StiffnessError

#: Largest ratio of |x'K y - y'K x| to |x| |K y| that counts as rounding in the assembly of a
#: symmetric K.
SYMMETRY = 1e-10

#: The force against a radial translation of length 1 counts as rounding up to this multiple of K's
#: largest diagonal entry; the form then lacks the hoop strain.
HOOP_ROUNDING = 1e-12

#: A negative radius counts as zero if its absolute value is at most this fraction of the largest
#: radius.
RADIUS_ROUNDING = 1e-9


def check_meridian(mesh: Any) -> None:
    """Check that a mesh is the meridian of bodies of revolution about the axis x = 0. Collective.

    Raises:
        InputError: the mesh is not in 2D, or has negative radii.
    """
    dim, radii = mesh.geometry.dim, mesh.geometry.x[:, 0]
    least, largest = reduce_array(
        mesh.comm, [radii.min(initial=np.inf), -np.abs(radii).max(initial=0.0)], MPI.MIN
    )
    if dim != 2 or least < RADIUS_ROUNDING * largest:
        geometry = f"a mesh in {dim}D" if dim != 2 else f"x[0] down to {least:.3g}"
        raise InputError(
            "axisymmetric=True needs a mesh in 2D, whose x[0] is the radius and not negative, and "
            f"whose x[1] is along the axis, found {geometry}."
        )


def check_hoop_stiffness(K: PETSc.Mat) -> None:
    """Check that an axisymmetric K resists a radial translation. Collective.

    Args:
        K: stiffness matrix of the displacement, before Dirichlet conditions are eliminated.

    Raises:
        InputError: K does not resist the translation: the form describes a plane body.
    """
    motion, force = K.createVecRight(), K.createVecLeft()
    diagonal = K.getDiagonal()
    motion.array = np.tile([1.0, 0.0], motion.local_size // 2)
    K.mult(motion, force)
    resistance, largest = (
        force.norm(PETSc.NormType.INFINITY),
        diagonal.norm(PETSc.NormType.INFINITY),
    )
    for vector in (motion, force, diagonal):
        vector.destroy()
    if resistance <= HOOP_ROUNDING * largest:
        raise InputError(
            "the form a is that of a plane body: it does not resist a radial translation. An "
            "axisymmetric form has the hoop strain u[0] / x[0] and the factor "
            "2 * pi * x[0], with x = ufl.SpatialCoordinate(mesh)."
        )


def check_symmetry(K: PETSc.Mat, cure: str) -> None:
    """Check that x'K y = y'K x for two oscillating vectors, which is cheaper than K - K'.

    Collective.

    Args:
        K: stiffness matrix.
        cure: advice for the message.

    Raises:
        StiffnessError: K is not symmetric.
    """
    x, y = K.createVecLeft(), K.createVecLeft()
    Kx, Ky = x.duplicate(), x.duplicate()
    start, end = x.getOwnershipRange()
    rows = np.arange(start, end)
    x.array = np.cos(12.9898 * rows)
    y.array = np.sin(78.233 * rows)
    K.mult(x, Kx)
    K.mult(y, Ky)
    defect = abs(x.dot(Ky) - y.dot(Kx))
    scale = x.norm() * Ky.norm()
    for vector in (x, y, Kx, Ky):
        vector.destroy()
    if defect > SYMMETRY * scale:
        raise StiffnessError(
            f"the stiffness matrix is not symmetric (relative defect {defect / scale:.1e}): "
            f"the form a(u, v) must equal a(v, u). {cure}"
        )


def check_signs(K: PETSc.Mat, not_displacement: Mask) -> None:
    """Check that C of a saddle-point matrix (A, B'; B, -C) has no negative diagonal entry.

    The pivots do not show this: if C is negative, the matrix may have the same number of negative
    pivots. Collective.

    Args:
        K: the saddle-point matrix.
        not_displacement: (owned unknowns,) whether each is free and no displacement.

    Raises:
        StiffnessError: a diagonal entry of C is negative.
    """
    diagonal = K.getDiagonal()
    entries = diagonal.array[not_displacement]
    diagonal.destroy()
    largest = K.comm.tompi4py().allreduce(float(entries.max(initial=-np.inf)), op=MPI.MAX)
    if largest > 0.0:
        raise StiffnessError(
            f"the stiffness matrix has {largest:.3g} on the diagonal of an unknown that is no "
            "displacement: a mixed space needs the form a(u, v) + b(v, p) + b(u, q) - c(p, q) "
            "with c(p, p) >= 0. Check the signs in it, and Poisson's ratio (at most 0.5)."
        )
