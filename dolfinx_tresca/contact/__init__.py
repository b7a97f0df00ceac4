"""Contact in one configuration, and the process of load steps around it.

`ContactSystem` pairs the surfaces, has K factored (`floating.HeldStiffness`), and holds the one
mutable reference to the state of the process, `ContactSystem.state`. Each of its solves is a dual
problem on the surfaces as they are paired now. `Obstacles` knows where rigid obstacles are and
were. The state itself is a `StepState`, which is never changed: a solve, an accepted step or a new
pairing sets another one. So a step that fails is undone by `ContactSystem.return_to`, which also
restores the user's u of nonlinear bodies, and a restart is the same object in a file
(`write_state`, `SavedState`). `FiniteSliding` chooses the configurations in which surfaces are
paired, until they are paired where the solution is; `solve_with_finite_sliding` and, for nonlinear
bodies, `problem.newton.Newton` repeat the solves.

A solve ends with a status in three steps: the iteration judges its iterates (`History.measures`),
`status_of_fields` compares the error bound of the fields with the accuracy that the user asked for,
and `ContactSystem.checked` looks whether slips, and of linear bodies rotations and strains, are
within the limits of their theory. `NonlinearContactProblem.solve` adds NO_EQUILIBRIUM. Newton's
method for nonlinear bodies asks for more accuracy than the user, whose request alone decides.

Symbols: B is `jump`, A is `compliance` (a `ContactCompliance`), x (multipliers) is
`StepState.multipliers`, the origin s of friction is `StepState.history.origin`.

The page of the room `dual` follows one solve through all rooms.

Read first: `step_state.StepState`, `contact_system.ContactSystem.begin_solve`,
`contact_system.ContactSystem.solve`.
"""
