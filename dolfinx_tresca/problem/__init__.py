"""Contact problems of linear and of nonlinear bodies, their processes, and Newton's method.

`ContactProblem` (`linear.py`) and `NonlinearContactProblem` (`nonlinear.py`) are processes of load
steps (`process.ContactProcess`) on a `contact.ContactSystem`, whose K is the stiffness or the
present tangent (`tangent_problem.py`). `newton.Newton` applies the load in parts, and each of its
steps is a solve of the same `TangentProblem`, a `ContactSystem` whose `linear` is a
`TangentSystem`: `solve` is inherited, load and stiffness are assembled at the present u, which
`Newton` moves. A load step calls `begin`, then for each Newton step `apply_load`, `factor`, `solve`
and `residual_norm`, and at last `end_load`. The room `derivatives` has what follows a solve.

Symbols: K is `LinearSystem.K` of linear bodies, or the tangent dR/du of nonlinear ones; R is the
residual `F` at u; f is chosen such that a step has the total displacement as its unknown.

Read first: `linear.ContactProblem.solve`, `process.ContactProcess.accept`, `newton.Newton.run`.
"""
