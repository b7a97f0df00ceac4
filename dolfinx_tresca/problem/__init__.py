"""Contact problems of linear and of nonlinear bodies, their processes, and Newton's method.

`ContactProblem` (`linear.py`) and `NonlinearContactProblem` (`nonlinear.py`) are processes of load
steps (`process.ContactProcess`) on a `contact.ContactSystem`, whose K is the stiffness or the
present tangent (`tangent_problem.py`). `newton.Newton` applies the load in parts, and each of its
steps is a solve of the same `TangentProblem`, a `ContactSystem` whose `linear` is a
`TangentSystem`: `solve` is inherited, load and stiffness are assembled at the present u, which
`Newton` moves. `NonlinearContactProblem.solve` calls `TangentProblem.begin`; `Newton.run` calls
`apply_load` for each part of the load, at first the whole, and its method `_equilibrium` repeats
`factor`, `solve` and `residual_norm` until this part is in equilibrium (`NewtonOptions` says by
which measure), or returns to the state before it and halves it; `end_load` puts obstacles back.
If the tangent is indefinite, `factor` adds springs in the contact, and then the stiffness of the
undeformed bodies (`newton.ADDED`), to both sides of the equations: solutions stay the same.

Symbols: K is `LinearSystem.K` of linear bodies, or the tangent dR/du of nonlinear ones; R is the
residual `F` at u. A step has the total displacement as its unknown: K u + B'lambda = K u_k -
R(u_k) + h, where h is the rest of the load that is not applied yet.

Read first: `linear.ContactProblem.solve`, `nonlinear.NonlinearContactProblem.solve`,
`newton.Newton.run`, `process.ContactProcess.accept`.
"""
