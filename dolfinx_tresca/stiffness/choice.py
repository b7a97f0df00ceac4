"""The solvers for K, a factorisation and multigrid, and the choice between them."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any, Literal, TypeAlias, get_args

from petsc4py import PETSc

import numpy as np

import dolfinx.fem.petsc
from dolfinx import fem

from dolfinx_tresca._base.arguments import check_word, checked_integer
from dolfinx_tresca._base.arrays import Mask
from dolfinx_tresca._base.parallel import log
from dolfinx_tresca.errors import InputError, StiffnessError
from dolfinx_tresca.stiffness.solver import StiffnessSolver, not_positive_definite

#: Workspace of MUMPS beyond its own estimate, in percent. The estimate may be too low by more than
#: the default of 20, as for a column of 300 bodies.
SPARE_WORKSPACE = 200


def cholesky(
    K: PETSc.Mat, petsc_options: Mapping[str, Any], prefix: str | None, constraints: int | None = 0
) -> StiffnessSolver:
    """Return a solver with the factors of K, or of a saddle-point matrix (A, B'; B, -C).

    Collective.

    Args:
        K: the matrix.
        petsc_options: PETSc options in addition to the defaults.
        prefix: prefix of the user's options in PETSc's database; None: there is none.
        constraints: number of unknowns other than displacements, such as pressures. The number of
            negative pivots must equal this number. By Sylvester's law of inertia A + B'C^-1 B is
            then positive definite; if C is zero, A is positive definite on the vectors u with
            B u = 0. None: the pivots are not checked.

    Raises:
        StiffnessError: the factorisation failed, or the pivots show that K is not positive
            definite, or that a saddle-point matrix is singular or has the wrong signs.
    """

    def check(ksp: PETSc.KSP) -> None:
        pc = ksp.getPC()
        if pc.getType() != PETSc.PC.Type.CHOLESKY or pc.getFactorSolverType() != "mumps":
            return  # the user has chosen another solver
        factor = pc.getFactorMatrix()
        failure, reason, negative, zero = map(factor.getMumpsInfog, (1, 2, 12, 28))
        if failure < 0:
            raise StiffnessError(
                f"MUMPS could not factor K: INFOG(1) = {failure}, INFOG(2) = {reason} "
                "(-10: singular, -9 or -13: out of memory; see its manual). For large models take "
                "stiffness='multigrid'."
            )
        if constraints == 0 and negative > 0:
            raise not_positive_definite(f"{negative} of {K.getSize()[0]} pivots are negative")
        if constraints != 0 and zero > 0:
            raise StiffnessError(
                f"K is singular: {zero} of {K.getSize()[0]} pivots are zero. Either nothing "
                "holds a body; or a pressure is not determined: if all of the boundary is clamped, "
                "it is known up to a constant only, and spaces must be a stable pair, such as "
                "degree 2 for u and degree 1 for p."
            )
        if constraints and negative != constraints:
            error = StiffnessError(
                f"K has {negative} negative pivots, but {constraints} unknowns that are no "
                "displacements: it is not K of a stable body with a pressure. Its form must be "
                "a(u, v) + b(v, p) + b(u, q) - c(p, q), with c(p, p) >= 0 and a positive definite "
                "where b(u, q) = 0 for all q. Check the signs in the form a, and the material data."
            )
            if negative > constraints:
                error.evidence = f"{negative - constraints} pivots of displacements are negative"
            raise error

    options: dict[str, Any] = {
        "ksp_type": "preonly",
        "pc_type": "cholesky",
        "pc_factor_mat_solver_type": "mumps",
        # CHOLMOD's default for small matrices, LDL', accepts negative pivots
        "mat_cholmod_factor": "SUPERNODAL",
        "mat_cholmod_print": 0,  # PETSc reports errors
        # METIS; a MUMPS built without it, such as Debian's, takes PORD (INFOG(7) = 4), which among
        # the orderings in Debian's MUMPS (AMD, AMF, QAMD, PORD) gives the sparsest factors of 3D
        # bodies
        "mat_mumps_icntl_7": 5,
        "mat_mumps_icntl_14": SPARE_WORKSPACE,
    }
    if constraints == 0:  # no pivoting: K is positive definite, or the check above fails
        options["mat_mumps_cntl_1"] = 0.0
    else:  # L D L' with pivots of size 1 and 2, whose signs are counted
        options["mat_mumps_icntl_13"] = 1  # no ScaLAPACK in the last front: it counts no signs
        options["mat_mumps_icntl_24"] = 1  # detect zero pivots
    return StiffnessSolver("cholesky", K, options, petsc_options, prefix, check=check)


def multigrid(
    K: PETSc.Mat,
    V: Any,
    prescribed: Mask,
    petsc_options: Mapping[str, Any],
    prefix: str | None,
) -> StiffnessSolver:
    """Return a solver for K by conjugate gradients with multigrid. Collective.

    For degree 2, errors are smoothed on V and on the space of degree 1 on the same mesh, and GAMG
    is applied to the matrix P'KP of the latter, with the interpolation P; for degree 1, GAMG is
    applied to K. If the options name a `pc_type`, GAMG or another, this preconditioner is applied
    to K; if they name a smoother, Chebyshev's polynomials complete its options.

    Args:
        K: the matrix, with the springs of floating bodies, if there are any, and with identity rows
            and columns for prescribed values.
        V: the space of the unknowns u.
        prescribed: (owned degrees of freedom,) whether each is prescribed.
        petsc_options: options of the user, which take precedence. Options of GAMG and of smoothers
            apply to all levels; with `mg_coarse_` before their names, only to the levels of GAMG,
            below degree 1.
        prefix: prefix of the options in PETSc's database.

    Raises:
        StiffnessError: the set-up failed.
    """

    def named(option: str) -> bool:
        """Return whether the user gives an option, by the argument or in PETSc's database."""
        in_database = prefix is not None and PETSc.Options(prefix).hasName(option)
        return option in petsc_options or in_database

    krylov: dict[str, Any] = {
        "ksp_type": "cg",
        "ksp_norm_type": "natural",  # sqrt(r'M^-1 r), which is nearly the error in the energy norm
        "ksp_rtol": 1e-10,
        "ksp_max_it": 500,
        "ksp_divtol": 1e300,  # the error only falls, but residuals may grow before they fall
    }
    gamg: dict[str, Any] = {
        "pc_type": "gamg",
        "pc_gamg_type": "agg",
        "pc_gamg_threshold": 0.01,
        "pc_gamg_esteig_ksp_max_it": 5,
    }
    smoother: dict[str, Any] = {"mg_levels_pc_type": "sor", "mg_levels_ksp_max_it": 1}
    kinds = ("ksp", "pc")
    names = [f"{level}mg_levels_{kind}_type" for level in ("", "mg_coarse_") for kind in kinds]
    if K.comm.size == 1 and not any(map(named, names)):
        # symmetric block Gauss-Seidel: errors fall in the energy norm for any positive definite K,
        # and the preconditioner is positive definite without an estimate of eigenvalues
        smoother["mg_levels_ksp_type"] = "richardson"
    else:
        # Each rank applies the Gauss-Seidel method to its own rows, M = diag(M_i). The largest
        # eigenvalue of M^-1 K may approach the number of ranks that meet at a node, and errors grow
        # if it exceeds 2 (on three and more ranks the preconditioner was seen to be indefinite).
        # Chebyshev's polynomial, made for this largest eigenvalue, avoids the growth. If its
        # estimate is too low, the smoother is indefinite: with stiffnesses that differ by 1e5, ten
        # steps of the estimate were too few.
        smoother["mg_levels_ksp_type"] = "chebyshev"
        smoother["mg_levels_esteig_ksp_max_it"] = 30
    gamg |= smoother
    if V.element.basix_element.degree == 1 or named("pc_type"):
        _set_rigid_body_modes(K, V)
        return StiffnessSolver("multigrid", K, krylov | gamg, petsc_options, prefix)
    levels: dict[str, Any] = {
        "pc_type": "mg",
        # two cycles of GAMG on the coarsest space. They are cheap, since K of degree 1 has a
        # fifteenth of the entries of K of degree 2; with one, a solve takes a third more iterations
        "mg_coarse_ksp_type": "richardson",
        "mg_coarse_ksp_max_it": 2,
        "mg_coarse_ksp_norm_type": "none",
        **smoother,
    }
    levels |= {f"mg_coarse_{name}": value for name, value in gamg.items()}
    below = {
        f"mg_coarse_{name}": value
        for name, value in petsc_options.items()
        if name.startswith(("pc_gamg_", "mg_levels_"))
    }
    prepare = partial(_add_degree_1, K=K, V=V, prescribed=prescribed)
    return StiffnessSolver(
        "multigrid", K, krylov | levels, below | dict(petsc_options), prefix, prepare
    )


def _add_degree_1(pc: PETSc.PC, K: PETSc.Mat, V: Any, prescribed: Mask) -> None:
    """Set up a preconditioner as multigrid with a level of degree 1 below degree 2. Collective.

    The matrix of the level is P'KP, with the interpolation P between the spaces. It needs no
    further compiled form, and includes additions to K, such as the springs of floating bodies.

    Args:
        pc: preconditioner of a KSP whose matrix is K.
        K: the matrix, with identity rows and columns for prescribed values.
        V: the space of degree 2.
        prescribed: (owned degrees of freedom,) whether each is prescribed.
    """
    coarse = fem.functionspace(V.mesh, ("Lagrange", 1, (V.dofmap.index_map_bs,)))
    P = dolfinx.fem.petsc.interpolation_matrix(coarse, V)
    P.assemble()
    free = K.createVecLeft()
    free.array = ~prescribed
    ones = P.copy()
    ones.chop(0.99)  # common nodes have a 1, and other nodes smaller entries
    coarse_free = ones.createVecRight()
    ones.multTranspose(free, coarse_free)
    coarse_free.array = coarse_free.array.round()
    # if either scaling is left out, corrections change prescribed values, and far more iterations
    # are needed
    P.diagonalScale(free, coarse_free)
    # a copy drops data for further products, which are larger than the matrix
    matrix = K.ptap(P).copy()
    held = matrix.getOwnershipRange()[0] + np.flatnonzero(coarse_free.array == 0.0)
    matrix.zeroRowsColumns(held.astype(PETSc.IntType), 1.0)
    matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    _set_rigid_body_modes(matrix, coarse)
    pc.setType(PETSc.PC.Type.MG)
    pc.setMGLevels(2)
    pc.setMGInterpolation(1, P)
    pc.getMGSmoother(0).setOperators(matrix)


def _set_rigid_body_modes(K: PETSc.Mat, V: Any) -> None:
    """Tell GAMG the rigid body modes, as the near-nullspace of a matrix on a space. Collective.

    Each mode moves all bodies together as one rigid body, so it is a rigid motion of each body,
    too: one set of modes serves any number of bodies.
    """
    nodes, dim = V.dofmap.index_map, V.mesh.geometry.dim
    points = PETSc.Vec().createMPI(
        (dim * nodes.size_local, dim * nodes.size_global), bsize=dim, comm=K.comm
    )
    points.array = V.tabulate_dof_coordinates()[: nodes.size_local, :dim].ravel()
    K.setNearNullSpace(PETSc.NullSpace().createRigidBody(points))


#: Name of a solver for K.
ChosenMethod: TypeAlias = Literal["cholesky", "multigrid"]

#: Name of a solver for K as users request it; "auto": `choose` decides.
StiffnessMethod: TypeAlias = Literal["auto", ChosenMethod]


#: Largest numbers of degrees of freedom of a body, by the dimension of space, for which K is
#: factored by default for one contact solve; above them multigrid is faster. The cost of factors
#: grows with the square of the size of each body, not of all bodies together. It hardly depends on
#: the degree of the displacements. With twice the limit in 3D, solves in between take up to twice
#: the time.
CHOLESKY_LIMITS = {2: 800_000, 3: 50_000}


def choose(
    method: StiffnessMethod,
    size: float,
    dim: int,
    expected_solves: int,
    comm: Any,
    *,
    saddle: bool = False,
) -> tuple[ChosenMethod, str]:
    """Return the name of the solver for K, and the reason for the choice. Not collective.

    The choice is logged if the method is "auto".

    Args:
        method: the requested method.
        size: number of degrees of freedom of a body, averaged over the degrees of freedom instead
            of over the bodies, so that large bodies decide.
        dim: dimension of space.
        expected_solves: expected number of contact solves with the same K.
        comm: communicator of the log.
        saddle: whether K belongs to a mixed space.

    Raises:
        InputError: the method is unknown or unsuitable for a mixed space, or the number of solves
            is not positive.
    """
    solves = checked_integer("expected_solves", expected_solves)
    check_word("stiffness", method, get_args(StiffnessMethod))
    if method == "multigrid" and saddle:
        raise InputError(
            "stiffness='multigrid' needs a positive definite K, and K of a mixed space is "
            "indefinite. Take stiffness='cholesky'; or, for models too large for it, the form "
            "of the displacement alone, with the volumetric part integrated with a lower "
            "quadrature_degree."
        )
    if method != "auto":
        return method, "requested"
    # each further solve adds a half, until factors would take too much memory
    limit = int(CHOLESKY_LIMITS[dim] * min(0.5 * (solves + 1), 5.0))
    chosen: ChosenMethod = "cholesky" if saddle or size <= limit else "multigrid"
    reason = (
        f"since {size:,.0f} unknowns of a body {'<=' if size <= limit else '>'} {limit:,} "
        f"(limit for {solves} solve(s) in {dim}D)"
    )
    if saddle:
        reason = "since multigrid needs a positive definite K"
    log(comm, "stiffness: %s, %s", chosen, reason)
    return chosen, reason
