"""Contact in one configuration, and the process of load steps around it.

`ContactSystem` pairs the surfaces, has K factored (`floating.HeldStiffness`), and holds the one
mutable reference to the state of the process, `ContactSystem.state`. Each of its solves is a dual
problem on the surfaces as they are paired at the moment. `Obstacles` knows where rigid obstacles
and the sides of cut bolts are, and whether the user has changed an obstacle since the pairing. The
state is a `StepState`, an immutable object: a solve, an accepted step or a new pairing sets another
one. So `ContactSystem.return_to` undoes a step that fails, with the user's u of nonlinear bodies,
and a restart reads such a state from a file (`write_state`, `SavedState`). `FiniteSliding` chooses
the displacements at which surfaces are paired, until this is the solution's;
`solve_with_finite_sliding` and, for nonlinear bodies, `problem.newton.Newton` repeat the solves.

The status of a solve is found in three steps: the iteration judges its iterates, by
`History.measures`; `status_of_fields` compares the error bound of the fields with the accuracy that
the user asked for (Newton's method for nonlinear bodies may ask for more, without effect on the
status); `ContactSystem.checked` looks whether slips, and of linear bodies rotations and strains,
are within the limits of their theory. `NonlinearContactProblem.solve` adds NO_EQUILIBRIUM.

Symbols: B is `jump`, A is `compliance` (a `ContactCompliance`), x (multipliers) is
`StepState.multipliers`, the slip origin s is `StepState.history.origin`.

The page of the room `dual` follows one solve through all rooms.

Read first: `step_state.StepState`, `contact_system.ContactSystem.begin_solve`,
`contact_system.ContactSystem.solve`.
"""
