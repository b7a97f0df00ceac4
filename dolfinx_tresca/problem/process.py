"""The interface of all contact problems: load steps, state files, derivatives, reactions."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import ufl
from dolfinx import fem

from dolfinx_tresca._base.agreement import collective, comm_of_self
from dolfinx_tresca._base.arguments import check_type
from dolfinx_tresca._base.arrays import Mask, integer
from dolfinx_tresca._base.parallel import log
from dolfinx_tresca._base.petsc import PetscOwner
from dolfinx_tresca.contact.contact_system import ContactSystem
from dolfinx_tresca.contact.saved_state import SavedState, write_state
from dolfinx_tresca.contact.step_state import StepSolution
from dolfinx_tresca.derivatives import goals
from dolfinx_tresca.derivatives.change_of_data import DataOfSolution
from dolfinx_tresca.derivatives.goals import ContactTangent
from dolfinx_tresca.derivatives.linearised import LinearisedContact
from dolfinx_tresca.derivatives.tape import ProcessTape
from dolfinx_tresca.dual.load_steps import SlipHistory
from dolfinx_tresca.errors import ContactError, InputError, shown
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.pairing.contact_operators import ContactOperators
from dolfinx_tresca.result import ContactSolution
from dolfinx_tresca.scene.pair import ContactPair, Goal, checked_goal, checked_pairs
from dolfinx_tresca.solution.fields import slip_from
from dolfinx_tresca.solution.forces import Resultant, Supports
from dolfinx_tresca.table import Row, Tabulated, Units


def problem_to_agree(problem: ContactProcess) -> dict[str, Any]:
    """Return what `collective` compares between ranks besides arguments. Not collective."""
    return {
        "options of the problem": problem.options,
        "newton of the problem": getattr(problem, "newton", None),
        "pairs": problem.pairs,
        **problem._contact.linear.values_to_agree(),
    }


def check_options(options: Any) -> None:
    """Check that options are `SolverOptions`. Not collective."""
    advice = " Options of the solver for K go to petsc_options."
    check_type("options", options, SolverOptions, "SolverOptions(...)", advice)


class ContactProcess(PetscOwner, Tabulated):
    """Base class of linear and nonlinear problems: load steps, state files, derivatives.

    Attributes:
        comm: the communicator of the mesh.
        mesh: the mesh of all bodies.
        prescribed: (owned degrees of freedom,) True where `bcs` prescribe the value: contact forces
            do not move these degrees of freedom.
        solves_exactly: whether solves with K are exact to rounding, since K is factored.
    """

    _contact: ContactSystem
    _tape: ProcessTape | None = None

    def __init__(self, pairs: Any, options: Any, units: Any) -> None:
        """Check and store the arguments that all problems have. Collective."""
        check_options(options)
        check_type("units", units, Units | None, 'such as Units("mm", "MPa")')
        self.options, self.units = options, units
        self.pairs: list[ContactPair] = checked_pairs(pairs)

    def _take(self, contact: ContactSystem) -> None:
        """Keep the discretised problem, and show some of its attributes. Not collective."""
        self._contact = contact
        self.comm, self.mesh = contact.comm, contact.linear.V.mesh
        self.prescribed: Mask = contact.linear.prescribed
        self.solves_exactly: bool = contact.compliance.exact

    @property
    def free_dofs(self) -> int:
        """The number of displacements that are not prescribed, on all ranks. Not collective."""
        return self._contact.summary.free_dofs

    @property
    def contact_nodes(self) -> int:
        """The number of nodes with multipliers, of all pairs on all ranks. Not collective."""
        return self._contact.summary.contact_nodes

    @property
    def operators(self) -> tuple[ContactOperators, ...]:
        """N, T, gap and areas of each pair, for other solvers: see `ContactOperators`. Collective.

        Nodes of two pairs with a common multiplier have rows in both, with a part of the area each.
        N and T act on the whole displacement, prescribed degrees of freedom included. Tangents are
        those of the last solve: orthotropic friction may turn them.
        """
        self._contact.check_not_destroyed()
        contact = self._contact
        contact.update_gaps()
        component = contact.linear.component
        # with a mixed space, K has more columns than V
        columns = () if component is None else (component.columns,)
        return tuple(
            ContactOperators(contact.linear.V, rows.operators, pair, *columns)
            for rows, pair in zip(contact.jump.by_pair, self.pairs, strict=True)
        )

    def _rows(self) -> list[Row]:
        method = f"{self.options.method}, {self.options.target}"
        return [*self._contact.rows(self.units), ("method", method)]

    def __repr__(self) -> str:
        summary, method = self._contact.summary, self._contact.stiffness.method
        return (
            f"<{type(self).__name__}: {summary.dofs} displacements, {summary.contact_nodes} "
            f"contact nodes in {len(self.pairs)} pair(s), {method}>"
        )

    def destroy(self) -> None:
        """Free the PETSc objects. Collective."""
        self._contact.destroy()

    def forget(self) -> None:
        """Drop multipliers and products of earlier solves; the next starts from zero multipliers.

        Accepted load steps stay: the slip still counts from the last accepted step. Not collective.
        """
        state = self._contact.state
        self._contact.state = state.started_at(np.zeros_like(state.multipliers))
        self._contact.compliance.forget()

    @collective(comm_of_self)
    def accept(self, *, unconverged: bool = False) -> None:
        """Make the last solution a load step, from which the slip of later solutions counts.

        Collective. After this call, friction resists T u - s, where the slip origin s is T u in the
        accepted step: linear bodies minimise 1/2 u'K u - f'u + sum of g |T u - s|. A solution that
        is not accepted has no effect on later ones. If slip bounds depend on the pressure, a
        solution may depend on where its solve starts; so solves start at the last accepted step.
        Nodes that stick keep their s, so that residuals do not add up from step to step.

        Args:
            unconverged: whether solutions that missed the accuracy, or left theory, are accepted.

        Raises:
            ContactError: nothing was solved since the last step, or a material's history changed.
            ConvergenceError: the last solve failed, or the scene has left linear theory.
        """
        with nullcontext() if self._tape is None else self._tape.adding_step():
            contact = self._contact
            solution = contact.state.acceptable(unconverged)
            contact.advance_material(solution)
            contact.state = contact.state.after_solution(solution)
            contact.obstacles.place(contact.state.accepted.motions, only_held_by_forces=True)

    @collective(comm_of_self, extra_values=problem_to_agree)
    def update_geometry(self, u: fem.Function | None = None) -> None:
        """Pair the surfaces in the configuration displaced by u. Collective.

        With small sliding, nodes keep their normals and their partners on the other side. This call
        takes the normals and partners in the configuration displaced by u; the gap at a later
        displacement v is d - N (v - u) with the distance d of the displaced surfaces, and stresses
        are forces divided by displaced areas. `sliding="finite"` does this in each solve. For an
        iteration of your own, repeat `solve` and `update_geometry` within a load step until the
        forces do not change any more, and then accept the step; with one call per step, the normals
        lag one step behind. If u is the displacement of the last solve, the next solve starts from
        the last tractions. Slip, accepted steps and multipliers are kept; products with A are
        dropped, since A changes. Bonded pairs do not change.

        Args:
            u: displacement [length] in the problem's space; None: the displacement of the last
                solution, or the present `u` of nonlinear bodies.

        Raises:
            InputError: u is no Function of that space, or has values that are NaN or infinite.
            PairingError: the displaced surfaces cannot be paired; the problem stays as it was.
            StiffnessError: a solve with K failed.
            ContactError: the problem was destroyed, or there is no solution.
        """
        contact = self._contact
        contact.check_not_destroyed()
        u = contact.displacement if u is None else u
        contact.linear.check_displacement("the displacement u of the surfaces", u)
        solution = contact.solved
        same = solution is not None and np.array_equal(solution.fields.u.x.array, u.x.array)
        continues = self.comm.allreduce(same, op=MPI.LAND)
        contact.pair_where_changed(u.copy(), u.copy())
        contact.state = replace(contact.state, continues=continues)

    @collective(comm_of_self, extra_values=problem_to_agree)
    def set_slip_origin(self, u: fem.Function | None) -> None:
        """Begin load steps at a displacement u: the slip of later solutions counts from T u.

        This continues from a state that another program computed. Slip against obstacles counts
        from their present places. Collective.

        Args:
            u: displacement [length] in the problem's space; None: the slip counts from the
                undeformed state, as before the first step.

        Raises:
            InputError: u is no Function of the problem's space, or has NaN or infinite values.
            ContactError: the problem was destroyed.
        """
        contact, jump = self._contact, self._contact.jump
        contact.check_not_destroyed()
        contact.obstacles.check_no_tools("a slip origin")
        if u is not None:
            contact.linear.check_displacement("the slip origin", u, " or None,")
        contact.record_motions()  # `after_step` takes the present places of obstacles
        slip = SlipHistory.none(jump) if u is None else SlipHistory.from_displacement(jump, u)
        contact.state = contact.state.after_step(slip, None if u is None else u.copy())

    @collective(comm_of_self)
    def continue_from(self, solution: ContactSolution) -> None:
        """Continue from a load step on another mesh, as after `accept()`. Collective.

        Slip counts from the solution's slip, which is interpolated; its dissipation is added to
        later dissipation. For nonlinear bodies interpolate u, too.

        Args:
            solution: a solution with the same number of pairs. Each point of a surface takes the
                slip of the nearest point of the same pair there, or zero where no point is near.

        Raises:
            InputError: pairs or dimensions differ; finite sliding, given forces or a preload.
            ConvergenceError: the solution did not converge.
        """
        dim = self.mesh.geometry.dim
        fits = isinstance(solution, ContactSolution) and len(solution.surfaces) == len(self.pairs)
        if not fits or solution.surfaces[0].mesh.geometry.dim != dim:
            raise InputError(
                f"continue_from needs a ContactSolution with {len(self.pairs)} pair(s) in {dim}D, "
                f"found {shown(solution)}."
            )
        if self._contact.slides_far:
            raise InputError(
                "a step on another mesh cannot be continued with finite sliding, which counts slip "
                "from the displacement of that step."
            )
        contact, jump = self._contact, self._contact.jump
        contact.obstacles.check_no_tools("the continuation of a step on another mesh")
        solution.raise_if_failed()
        contact.record_motions()
        slips = slip_from(solution.surfaces, jump)
        history = SlipHistory.from_slip(jump, slips, solution.total_dissipation)
        contact.state = contact.state.after_step(history, None)

    @collective(comm_of_self, ignored=("path",))
    def save_state(
        self, path: str | Path, *, step: int = 0, material: Sequence[fem.Function] = ()
    ) -> None:
        """Write the state of the process to a file, for `load_state` in another run. Collective.

        The file holds the multipliers, the slip and the dissipation of the accepted steps, u of
        nonlinear bodies, the places of obstacles, and the displacements at which surfaces are
        paired, but no loads or products with A. An interrupted write leaves the previous file.

        Args:
            path: path of the file; the first rank's value counts.
            step: a number that `load_state` returns, such as the number of the load step.
            material: Functions of the history of a material, on this mesh, with values at nodes,
                in cells or at points of quadrature.

        Raises:
            InputError: the file cannot be written, step is no integer, or material is no sequence
                of Functions on the mesh.
        """
        number = integer(step)
        if number is None:
            raise InputError(f"step must be an integer, such as 3, found {shown(step)}.")
        self._check_material(material)
        path, contact = Path(self.comm.bcast(str(path))), self._contact
        write_state(path, contact.state.at_start(contact.depends_on_start), number, material)

    @collective(comm_of_self, ignored=("path",))
    def load_state(self, path: str | Path, *, material: Sequence[fem.Function] = ()) -> int:
        """Continue the process that `save_state` wrote, on any number of ranks. Collective.

        With the same loads, the steps that follow have the results of a run without interruption.
        Surfaces are paired in the configuration in which they were paired when the file was
        written, and rigid obstacles are moved to where they were at the accepted step.

        Args:
            path: path of a file that a problem on the same mesh with the same pairs has written.
            material: Functions that receive the values of the Functions given to `save_state`, in
                the same order and spaces.

        Returns:
            the `step` that was saved.

        Raises:
            InputError: the file cannot be read, or it belongs to another mesh, to other pairs, to
                laws of another kind (with friction, without friction, bonded), or to another
                number of Functions of the material; then nothing has changed.
        """
        contact = self._contact
        contact.check_not_destroyed()
        self._check_material(material)
        saved = SavedState(Path(self.comm.bcast(str(path))), contact.state, material)
        former, motions = contact.state, contact.obstacles.motions
        try:
            contact.obstacles.place(saved.motions)
            contact.pair_where_changed(saved.configuration, saved.geometry)
            contact.state = saved.state(contact.state)
        except ContactError:
            contact.obstacles.place(motions)
            contact.return_to(former)
            raise
        for function, read in zip(material, saved.material, strict=True):
            function.x.array[:] = read.x.array
        return saved.step

    def _check_material(self, material: Sequence[fem.Function]) -> None:
        """Check the Functions of a material's history. Not collective."""
        if not isinstance(material, Sequence) or not all(
            isinstance(function, fem.Function) and function.function_space.mesh is self.mesh
            for function in material
        ):
            raise InputError(
                "material must be a list of Functions on the mesh of the problem, found "
                f"{shown(material)}."
            )

    @collective(comm_of_self)
    def goal_value(self, goal: Goal) -> float:
        """Return the value of a goal in the last solution. Collective.

        Args:
            goal: a `NormalForce`, `ContactForce`, `MeanPressure`, `MeanSlip` or `PressureNorm`.

        Raises:
            ContactError: nothing was solved since K or the pairing changed.
            InputError: the goal is wrong.
        """
        self._contact.obstacles.check_no_tools("the value of a goal")
        goal = checked_goal(goal, len(self.pairs), self.mesh.geometry.dim)
        solved = self._contact.solution_for("the value of a goal")
        jump = solved.dual.jump
        return goals.value_of(goal, solved.multipliers, jump, jump.of_displacement(solved.fields.u))

    @collective(comm_of_self)
    def gradient(
        self, goal: Goal | ufl.Form, controls: Sequence[fem.Constant | fem.Function]
    ) -> list[Any]:
        """Return the derivatives of a goal of the last solution with respect to controls.

        Collective. The derivatives are exact for the discrete problem, with each node held in its
        contact state; where nodes are about to change it (`NodeCounts.undecided`, which is logged),
        they are one-sided. All together cost one adjoint solve, about ten products with A, and for
        nonlinear bodies one Newton step. Solve accurately, with `solve(rtol=1e-8)`, since
        derivatives are evaluated at the computed solution.

        Args:
            goal: a `NormalForce`, `ContactForce`, `MeanPressure`, `MeanSlip` or `PressureNorm`;
                or a form of rank 0 that depends on `solution.u`, such as the compliance
                `ufl.action(L, solution.u)`.
            controls: Constants and Functions that occur in the forms, in the values of Dirichlet
                conditions, in the gap of a pair, or in a slip bound, a coefficient of friction or
                its limit, if these are the same in all directions; and Constants that a Python
                function reads, such as a friction curve or the signed distance of an obstacle. A
                derivative with respect to the coordinates of the mesh is not available.

        Returns:
            for each control the derivatives with respect to its values [unit of the goal divided by
            the unit of the control]: for a Constant, an array of its shape; for a Function, a
            Function on its space. If all derivatives by a control are zero, the log says so.

        Raises:
            ContactError: there is no converged solution for the present inputs; or, for nonlinear
                bodies, the solution was accepted already.
            InputError: the goal or a control is wrong; a control is part of a direction or of two
                bounds of orthotropic friction, or a Function that a Python function reads; `a` is
                no form of UFL, or is on a mixed space; or a pair has finite sliding, whose pairing
                depends on the solution.
            ConvergenceError: with the contact state kept, rigid motions of bodies change the goal.
        """
        data = self._data_of_solution(controls)
        gradient, *_ = goals.gradient(data, [(1.0, data.checked_goal(goal))], controls)
        return goals.as_derivatives(gradient, controls, self.comm)

    @collective(comm_of_self)
    def tangent(
        self, controls: Sequence[fem.Constant | fem.Function], directions: Sequence[Any]
    ) -> ContactTangent:
        """Return the derivative of the last solution in a direction of controls. Collective.

        This is the first-order change of all fields and goals, with each node held in its contact
        state, for about ten products with A; `gradient` gives one goal's change in all directions.

        Args:
            controls: see `gradient`.
            directions: for each control its change: for a Constant, values of its shape; for a
                Function, a Function on its space.

        Returns:
            the changes of displacement, pressure, traction, slip and gap, and of any goal.

        Raises:
            ContactError: see `gradient`.
            InputError: a control or a direction is wrong; see also `gradient`.
            ConvergenceError: with its contact state, nothing holds a body against changes of loads.
        """
        data = self._data_of_solution(controls)
        directions = goals.checked_directions(controls, directions)
        return goals.tangent_of(data, self._contact.secondary, controls, directions)

    def _data_of_solution(self, controls: Sequence[Any]) -> DataOfSolution:
        """Return the data of the last solution, ready for derivatives by controls. Collective."""
        self._check_pairing_fixed()
        solved = self._solved_for("a derivative")
        self._contact.check_inputs("a derivative")
        u, bounds = solved.fields.u, self._contact.slip_bounds()
        if count := solved.fields.counts.undecided:
            text = "derivative: %d node(s) are about to change their state: it is one-sided"
            log(self.comm, text, count)
        data = DataOfSolution(self._contact, self._residual_at(u), u)
        data.linearise(LinearisedContact(solved.dual, solved.multipliers, u, bounds))
        data.check_controls(controls)
        return data

    @collective(comm_of_self)
    def reaction(self, where: Any, point: npt.ArrayLike | None = None) -> Resultant:
        """Return the force and moment that a support exerts on the bodies in the last solution.

        Collective. At prescribed degrees of freedom, the force balances internal forces, loads and
        contact. Springs are terms of `a` (or F) over facets with the tag in which u occurs, such as
        `k * inner(u, v) * ds(7)`. With finite sliding forces act at the displaced places.

        Args:
            where: the tag of a surface in the `facet_tags` of the first pair, or one of `bcs`. The
                solution's table and report show the result, by the name of the tag.
            point: (d,) reference point of the moment [length]; None: the middle of the box of all
                points at which these forces act.

        Raises:
            ContactError: there is no solution, it has not converged, or loads have changed since.
            InputError: the tag or the condition is unknown, nothing holds the bodies there, or the
                forms are on a mixed space.

        Example:
            The weight on a support with the tag 7:

            >>> problem.reaction(7).force[2]  # doctest: +SKIP
        """
        contact = self._contact
        fields = contact.solution_for("reaction()").fields
        u = getattr(self, "u", fields.deformation)
        facet_tags = self.pairs[0].given_tags("secondary")[0]
        supports = Supports(
            self._residual_at(u), contact.linear, u, fields.contact_force, facet_tags
        )
        displaced = fields.u if contact.slides_far else None
        result = supports.reaction(where, point, displaced=displaced, frames=contact.jump.frames)
        tag = integer(where)
        if tag is None:
            name = f"bcs[{[where is bc for bc in contact.linear.bcs].index(True)}]"
        else:
            name = getattr(facet_tags, "names", {}).get(tag, f"tag {tag}")
        fields.reactions[name] = result
        return result

    def _check_pairing_fixed(self) -> None:
        """Check that the pairing of surfaces does not depend on the solution. Not collective."""
        if self._contact.slides_far:
            raise InputError(
                'a derivative is not known for pairs with sliding="finite": the pairing of their '
                "surfaces depends on the solution."
            )

    def _solved_for(self, purpose: str) -> StepSolution:
        """Return the last solve, with K at its solution; errors name the purpose. Collective."""
        contact = self._contact
        contact.obstacles.check_no_tools(purpose)
        if contact.linear.component is not None:
            raise InputError(
                f"{purpose} needs a form of the displacement alone, and not that of a mixed space: "
                "compare two solutions."
            )
        return contact.solution_for(purpose)

    @abstractmethod
    def _residual_at(self, u: fem.Function) -> ufl.Form:
        """Return internal minus external forces at u, a form of rank 1. Not collective."""
