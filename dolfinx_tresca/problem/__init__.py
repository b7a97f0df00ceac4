"""Contact problems of linear and of nonlinear bodies, their processes, and Newton's method.

`ContactProblem` (`linear.py`) and `NonlinearContactProblem` (`nonlinear.py`) are processes of load
steps (`process.ContactProcess`) on a `contact.ContactSystem`, whose K is the stiffness or the
present tangent (`tangent_problem.py`). Each step of `newton.Newton` is a solve of the same
`TangentProblem`, a `ContactSystem` whose `linear` is a `TangentSystem`: `solve` is inherited, load
and stiffness are assembled at the present u, to which `Newton` gives the result of each step. The
page of the room `dual` follows the contact solve itself.

`NonlinearContactProblem.solve` calls `TangentProblem.begin`; `Newton.run` calls `apply_load` for
each part of the load, at first the whole, and then `Newton._equilibrium`. This repeats
`Newton._step`, which calls `factor` and `solve`, and `Newton._move_to`, which moves u and calls
`residual_norm`, until this part is in equilibrium (`NewtonOptions` says by which measure). If this
fails, `run` returns to the state before the part, and halves the part. If the tangent is
indefinite, a step lets `factor` add springs in the contact, and then also the stiffness of the
undeformed bodies (`newton.ADDED`), to both sides of the equations: solutions stay the same. At the
end, `end_load` puts obstacles where the user has placed them. The status is that of the last
contact solve, or NO_EQUILIBRIUM or STOPPED if less than the whole load was applied.

Symbols: K is `LinearSystem.K` of linear bodies, or the tangent dR/du of nonlinear ones; R is the
residual `F` at u. A step has the total displacement as its unknown: K u + B'lambda = K u_k -
R(u_k) + h. R contains the whole load, and h = (1 - t) r_0 takes back what is not applied yet: t is
`TangentSystem.fraction`, r_0 is R + B'lambda at the start.

Read first: `linear.ContactProblem.solve`, `nonlinear.NonlinearContactProblem.solve`,
`newton.Newton.run`, `process.ContactProcess.accept`.
"""
