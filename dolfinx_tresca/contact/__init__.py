"""Contact in one configuration, and the process of load steps around it.

A `ContactSystem` makes one solve: K, the surfaces as they are paired now, and the dual problem on
them. `ContactSurfaces` pairs the surfaces, and holds the one mutable reference to the state of the
process. The state itself is a `StepState`, which is never changed: a solve, an accepted step or a
new pairing returns another one. So a step that fails is undone by `ContactSurfaces.return_to`, and
a restart is the same object in a file (`write_state`, `SavedState`). `FiniteSliding` repeats solves
until the surfaces are paired where the solution is.

Symbols: B is `jump`, A is `compliance`, x (multipliers) is `StepState.multipliers`, the origin s of
friction is `StepState.history.origin`.

Read first: `step_state.StepState`, `contact_surfaces.ContactSurfaces.begin_solve`,
`contact_system.ContactSystem.solve`.
"""
