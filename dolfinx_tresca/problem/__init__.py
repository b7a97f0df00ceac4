"""Contact problems of linear and of nonlinear bodies, their processes, and Newton's method.

`ContactProblem` (`linear.py`) and `NonlinearContactProblem` (`nonlinear.py`) are processes of load
steps (`process.ContactProcess`) on a `contact.ContactSystem`, whose K is the stiffness or the
present tangent (`tangent_system.py`). `newton.Newton` applies the load in parts, and each of its
steps is a contact problem (`tangent_problem.py`). `tape.py` has derivatives through load steps.

Read first: `linear.ContactProblem.solve`, `process.ContactProcess.accept`, `newton.Newton.run`.
"""
