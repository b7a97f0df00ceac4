"""Force and moment of supports: of Dirichlet conditions, and of springs on the boundary."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx.la
import ufl
from dolfinx import fem

from dolfinx_tresca._base.arrays import Array, Mask
from dolfinx_tresca._base.number import integer
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca.errors import ContactError, InputError, shown
from dolfinx_tresca.solution.forms import Forms
from dolfinx_tresca.solution.resultants import Resultant, centre_of_forces, resultants_on
from dolfinx_tresca.stiffness.frames import BodyFrames

#: Largest force at free nodes, relative to the largest nodal force, with which loads are those of
#: the solution. Solutions of the default accuracy are below a hundredth of this.
BALANCED = 2e-2


def reaction_at(
    forms: Forms,
    u: fem.Function,
    contact_force: fem.Function,
    prescribed: Mask,
    facet_tags: Any,
    where: Any,
    point: npt.ArrayLike | None,
    *,
    moved: fem.Function | None = None,
    frames: BodyFrames | None = None,
) -> Resultant:
    """Return the force and moment that a support exerts on the bodies. Collective.

    At prescribed degrees of freedom the forces of the support balance internal forces, loads and
    contact. Springs are the terms of the forms over facets with the tag in which u occurs.

    Args:
        forms: the forms and conditions of the bodies.
        u: the displacement in these forms, of the solution; with `frames` the displacement in them.
        contact_force: contact forces on all nodes [force].
        prescribed: (owned dofs,) whether a Dirichlet condition prescribes the degree of freedom.
        facet_tags: tags of facets, for tags.
        where: the tag of a surface, or a Dirichlet condition of the problem.
        point: (d,) reference point of the moment [length]; None: the middle of all these forces.
        moved: displacement of the places at which forces act [length]; None: the undeformed places.
        frames: the frames of linear bodies that have turned; None: there are none.

    Raises:
        InputError: `where` is neither of both, no facet has the tag, nothing holds it, or the forms
            are on a mixed space.
        ContactError: loads or coefficients have changed since the solution.
    """
    V = contact_force.function_space
    comm, dim = V.mesh.comm, V.mesh.geometry.dim
    if u.function_space.element != V.element:
        raise InputError("reaction() needs forms of the displacement alone, not of a mixed space.")
    residual = forms.residual(ufl.TestFunction(V))

    def nodal(form: Any) -> Array:
        vector = fem.Function(V)
        fem.assemble_vector(vector.x.array, forms.compiled(form))
        vector.x.scatter_reverse(dolfinx.la.InsertMode.add)
        return np.asarray(vector.x.array[: len(prescribed)])

    forces = nodal(residual)
    if frames is not None:  # loads are in space, internal forces in the frames
        loads = nodal(ufl.replace(residual, {u: fem.Function(u.function_space)}))
        forces = frames.into_space(forces - loads) + loads
    forces -= contact_force.x.array[: len(prescribed)]
    sizes = [np.abs(forces[rows]).max(initial=0.0) for rows in (~prescribed, slice(None))]
    sizes.append(np.abs(contact_force.x.array).max(initial=0.0))
    unbalanced, *largest = reduce_array(comm, sizes, MPI.MAX)
    if unbalanced > BALANCED * max(largest):
        raise ContactError(
            "loads, prescribed values or coefficients have changed since the solution, or it has "
            f"not converged: forces at free nodes are {unbalanced / max(largest):.2g} of the "
            "largest force. Call solve() before reaction()."
        )
    held = np.zeros(len(prescribed), dtype=np.bool_)
    tag = integer(where)
    springs: list[Any] = []
    if tag is None:
        if not any(where is bc for bc in forms.bcs):
            raise InputError(
                "reaction() needs the tag of a surface, or a Dirichlet condition in the list bcs "
                f"of the problem, found {shown(where)}."
            )
        dofs, owned = where.dof_indices()
        held[dofs[:owned]] = True
    else:
        facets = facet_tags.find(tag)
        if reduce_array(comm, len(facets)) == 0:
            raise InputError(f"no facet has the tag {tag}.")
        nodes = fem.locate_dofs_topological(V, facet_tags.dim, facets)
        nodes = nodes[nodes < V.dofmap.index_map.size_local]
        held.reshape(-1, dim)[nodes] = True
        springs = [
            integral
            for integral in residual.integrals()
            if integral.integral_type() == "exterior_facet"
            and tag in np.atleast_1d(integral.subdomain_id())
            and u in ufl.algorithms.extract_coefficients(integral.integrand())
        ]
    held &= prescribed
    if not springs and not reduce_array(comm, int(held.sum())):
        raise InputError(f"nothing holds the bodies at {shown(where)}: no condition and no spring.")
    forces = np.where(held, forces, 0.0)
    if springs:
        only = [spring.reconstruct(subdomain_id=tag) for spring in springs]
        forces -= nodal(ufl.Form(only))
    rows = forces.reshape(-1, dim)
    places = V.tabulate_dof_coordinates()[: len(rows), :dim]
    if moved is not None:
        places = places + moved.x.array[: len(prescribed)].reshape(-1, dim)
    centre = centre_of_forces(comm, places, rows)
    index = np.zeros(len(rows), dtype=np.intp)
    (result,) = resultants_on(comm, [(places, rows, index)], 1, centre)
    return result if point is None else result.about(point)
