"""One node on a plane with a large coefficient of friction: one solution, three, and a jump.

    tools/fenicsx python3 benchmarks/published_cases/one_node.py

A. Klarbring, Examples of non-uniqueness and non-existence of solutions to quasistatic contact
problems with friction, Ing. Arch. 60, 1990; P. Hild, Non-unique slipping in the Coulomb friction
model in two-dimensional linear elasticity, 2004. A triangle of which two nodes are held; the third
is pressed on a plane by N and pulled along it by T. Its stiffness [K_tt, K_tn; K_tn, K_nn] couples
both directions. F exceeds the critical coefficient K_tt / K_tn. If T / N is between the critical
coefficient and F, the node may stick, slip, or be open. Before T is applied, a load step with N
alone was accepted, in which the node sticks. When T grows beyond F N, the rate problem has no
solution, and after the next load step the node is open. There is only one mesh.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
from case import RTOL, Case, Result, by_group, exactly

import ufl
from dolfinx import fem
from dolfinx import mesh as meshes

from dolfinx_tresca import ContactPair, ContactProblem, Coulomb, RigidPlane
from scenes.elasticity import elasticity, lame_constants
from scenes.nodal import nodal, surface_nodes_of
from scenes.patches import mesh_of

YOUNG, POISSON, COEFFICIENT = 1.0, 0.3, 2.0  # -, -, -
PRESSED = 1e-3  # N

#: Nodes of the triangle, of which the first one is free; then the triangle's area, and the gradient
#: of the free node's shape function.
NODES = np.array([[0.0, 0.0], [1.0, 0.0], [-0.873, 1.0]])
AREA, GRADIENT = 0.5, np.array([-1.0, -1.873])

MU, LAME = lame_constants(YOUNG, POISSON)
STIFFNESS = AREA * (
    MU * GRADIENT @ GRADIENT * np.eye(2) + (LAME + MU) * np.outer(GRADIENT, GRADIENT)
)

#: T/N at which the node sticks; at which it may stick, slip or be open; and at which it must be
#: open.
ONE, THREE, JUMP = 1.2, 1.75, 2.2

#: T/N of the load steps that the picture shows.
PULLS = np.linspace(0.0, JUMP, 46)


def slipping() -> float:
    """Return (normal force) / N of the solution that slips."""
    (tt, tn), _ = STIFFNESS
    return float(1.0 - tn * (COEFFICIENT - THREE) / (COEFFICIENT * tn - tt))


def solve(comm: MPI.Comm, _: float) -> Result:
    """Solve the load steps. Collective."""
    triangle = mesh_of(comm, "triangle", 1, NODES, np.array([[0, 1, 2]]))
    facets = meshes.locate_entities_boundary(triangle, 1, lambda x: np.isclose(x[1], 0.0))
    tags = meshes.meshtags(triangle, 1, facets, np.ones(len(facets), dtype=np.int32))
    V = fem.functionspace(triangle, ("Lagrange", 1, (2,)))
    held = fem.locate_dofs_geometrical(V, lambda x: np.abs(x[0]) > 0.5)
    bcs = [fem.dirichletbc(np.zeros(2), held, V)]
    load = fem.Constant(triangle, np.zeros(2))
    L = ufl.inner(load, ufl.TestFunction(V)) * ufl.dx
    plane = RigidPlane(point=(0.0, 0.0), normal=(0.0, 1.0))
    pair = ContactPair(tags, 1, plane, Coulomb(COEFFICIENT))
    a = elasticity(V, YOUNG, POISSON)

    def force_at(problem: ContactProblem, pull: float) -> tuple[float, np.ndarray]:
        """Return (normal force) / N, and the displacement of the node."""
        load.value[:] = 3.0 / AREA * PRESSED * np.array([-pull, -1.0])
        solution = problem.solve(rtol=RTOL)
        solution.raise_if_failed()
        problem.accept()
        _, fields = surface_nodes_of(solution)
        force = comm.allreduce(float(fields["pressure"] @ fields["weights"]))
        u = comm.allreduce(nodal(solution.u).sum(axis=0))
        return force / PRESSED, u

    with ContactProblem(a, L, [pair], bcs) as problem:
        cold, _ = force_at(problem, THREE)
    with ContactProblem(a, L, [pair], bcs) as problem:
        force_at(problem, 0.0)
        one, _ = force_at(problem, ONE)
        three, _ = force_at(problem, THREE)
        _, u = force_at(problem, JUMP)
    with ContactProblem(a, L, [pair], bcs) as problem:
        path = np.array([force_at(problem, pull)[0] for pull in PULLS])
    free = np.linalg.solve(STIFFNESS, PRESSED * np.array([-JUMP, -1.0]))
    values = (one, cold, three, float(u @ free / (free @ free)))
    return Result(dict(zip(PUBLISHED, values, strict=True)), V, PULLS, path)


ALL = by_group({"sticks": 1.0, "slips": slipping(), "open": 0.0})
PUBLISHED = {
    f"T = {ONE:g} N, after N alone: normal force over N": exactly(1.0),
    f"T = {THREE:g} N, at once: normal force over N": ALL,
    f"T = {THREE:g} N, after N alone: normal force over N": ALL,
    f"T = {JUMP:g} N, next step: displacement over the free one": exactly(1.0),
}
CASE = Case(
    name="one_node",
    title="One node, F beyond critical",
    published=PUBLISHED,
    source="formula",
    argument="triangles",
    sizes=(1,),
    solve=solve,
    axes=("T / N", "normal force over N"),
    curve=(np.array([0.0, COEFFICIENT, COEFFICIENT, JUMP]), np.array([1.0, 1.0, 0.0, 0.0])),
)

if __name__ == "__main__":
    CASE.main()
