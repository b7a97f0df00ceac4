# %% [markdown]
# # Hertz contact: a ball on a plane, two balls, a cylinder on a plane
#
# A soft ball is pressed on a rigid plane, without friction. Heinrich Hertz found the pressure in
# 1881: half an ellipsoid over a disc whose radius a grows with the cube root of the force. It is
# the touchstone of contact software, because the size of the contact is not known beforehand. The
# same law holds for two balls, which count as one ball of another radius and modulus, and a similar
# law for a cylinder that lies on a plane.
#
#       | | | approach                                    p
#       v v v                                       peak -|-._
#       +-------- z = R                                   |    `-.
#       |       .'                                        |       `.
#       |      /    by symmetry an octant                 |         \
#       |    .'     of the ball is enough                 |          |
#       | _-'                                             +----------+---- r
#     //////////// rigid plane                            0          a
#
# The ball on the plane takes up to 7,300 nodes, the two balls 16,000, the cylinder 1,500; all
# three, with linear and with quadratic elements, ten seconds and 800 MB.
#
# **Strong form.** In each body -div sigma(u) = 0 with sigma = 2 mu strain + lambda tr(strain) I.
# The cut through the middle of the upper body is moved down by the approach; that of the lower
# body, if there is one, is held. On the contact surface, with the pressure p and the gap:
# p >= 0, gap >= 0, p gap = 0. There is no friction, so no tangential traction.
#
# **Theory.** With 1/R = 1/R_upper + 1/R_lower (a plane has no curvature), the modulus
# 1/E = (1 - nu^2)/E_young of both bodies added (a rigid one has none), and the force F:
#
#     balls      a^3 = 3 F R / (4 E)      peak = 3 F / (2 pi a^2)    p = peak sqrt(1 - r^2/a^2)
#     cylinders  a^2 = 4 F R / (pi E)     peak = 2 F / (pi a)        p = peak sqrt(1 - r^2/a^2)
#
# (F is per length for the cylinders: K. L. Johnson, Contact Mechanics, sections 4.2 and 5.6.) The
# theory takes the bodies for half-spaces with a parabola on them: its error is of order (a/R)^2.

# %%
from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca import (
    MESHES,
    ContactPair,
    ContactProblem,
    ContactSolution,
    Frictionless,
    RigidPlane,
    TaggedMesh,
    Units,
    read_gmsh,
)

# %% [markdown]
# ## Data
# Lengths in mm, stresses in MPa, so forces come in N. The bodies are of rubber foam.

# %%
HERE = Path(__file__).parent
RESULTS = HERE.parent / "results"
UNITS = Units("mm", "MPa", force="N")

YOUNG = 10.0  # MPa, the upper body
POISSON = 0.3
LOWER_YOUNG = 20.0  # MPa, the lower ball
LOWER_POISSON = 0.4
RADIUS = 10.0  # mm, the upper body
LOWER_RADIUS = 20.0  # mm, the lower ball


def plane_strain_modulus(young: float, poisson: float) -> float:
    """Return E/(1 - nu^2) [MPa]."""
    return young / (1 - poisson**2)


# %% [markdown]
# ## What Hertz says
# How far the middle of a ball moves does not follow from what happens near the contact alone: the
# ball is held by an equal force from the other side, which drives the contact back. That is small,
# some 5 percent of the approach here; the displacement of a half-space at the depth 2 R under a
# point load is a good guess of it (Y. Tatara, J. Eng. Mater. Technol. 113, 1991). For cylinders the
# approach has a formula of its own (Johnson, equation 5.57).


# %%
def far_compliance(radius: float, young: float, poisson: float) -> float:
    """Return how far a unit force moves the opposite end of a ball [mm/N]."""
    return ((1 + poisson) / 4 + (1 - poisson**2) / 2) / (math.pi * young * radius)


@dataclass(frozen=True)
class HertzSphere:
    """Two balls, or a ball and a plane, pressed together by a force."""

    force: float  # N
    radius: float  # mm, R
    modulus: float  # MPa, E
    far: float = 0.0  # mm/N, how far the load opposite to the contact drives it back

    @property
    def contact_radius(self) -> float:
        """Radius a of the contact [mm]."""
        return (0.75 * self.force * self.radius / self.modulus) ** (1 / 3)

    @property
    def peak(self) -> float:
        """The pressure in the middle [MPa]."""
        return 1.5 * self.force / (math.pi * self.contact_radius**2)

    @property
    def approach(self) -> float:
        """How much the middles of the bodies approach each other [mm]."""
        return self.contact_radius**2 / self.radius - self.far * self.force

    def pressure(self, r: Any) -> Any:
        """Return the pressure [MPa] at distances r [mm] from the middle."""
        return self.peak * np.sqrt(np.maximum(1 - (r / self.contact_radius) ** 2, 0))


@dataclass(frozen=True)
class HertzLine:
    """A cylinder and a plane, pressed together by a force per length."""

    force: float  # N/mm
    radius: float  # mm, R
    modulus: float  # MPa, E

    @property
    def contact_radius(self) -> float:
        """Half the width of the contact, a [mm]."""
        return math.sqrt(4 * self.force * self.radius / (math.pi * self.modulus))

    @property
    def peak(self) -> float:
        """The pressure in the middle [MPa]."""
        return 2 * self.force / (math.pi * self.contact_radius)

    @property
    def approach(self) -> float:
        """How much the axis of a cylinder between two planes approaches each of them [mm]."""
        logarithm = 2 * math.log(4 * self.radius / self.contact_radius) - 1
        return self.force / (math.pi * self.modulus) * logarithm

    def pressure(self, r: Any) -> Any:
        """Return the pressure [MPa] at distances r [mm] from the middle."""
        return self.peak * np.sqrt(np.maximum(1 - (r / self.contact_radius) ** 2, 0))


# %% [markdown]
# ## The scenes
# Each is an ordinary FEniCSx problem up to the pair. The rigid plane needs no mesh.


# %%
@dataclass(frozen=True)
class Scene:
    """What a user of FEniCSx has, the pair, and what to compare with."""

    name: str
    bodies: TaggedMesh
    V: Any
    a: Any
    L: Any
    bcs: list[Any]
    pair: ContactPair
    h: float  # mm, size of the largest cells at the contact
    approach: float  # mm
    share: int  # so many of the bodies' parts that are meshed make the whole contact
    theory: Callable[[float], HertzSphere | HertzLine]  # of the force


def sphere_on_plane(
    comm: MPI.Comm, h: float = 0.12, *, degree: int = 1, approach: float = 0.144
) -> Scene:
    """Return a ball on a rigid plane: octant, cells of size h [mm] at the contact."""
    contact = math.sqrt(RADIUS * approach)
    bodies = read_gmsh(
        MESHES / "sphere_octant.geo",
        comm,
        R=RADIUS,
        h=h,
        Zone=1.4 * contact,
    )
    V, a, L = elasticity(bodies, degree, {"upper": (YOUNG, POISSON)})
    bcs = [
        fix(V, bodies, "upper_x", 0),
        fix(V, bodies, "upper_y", 1),
        fix(V, bodies, "upper_cut", 2, -approach),
    ]
    pair = ContactPair(
        bodies.facet_tags,
        secondary=bodies.tags["upper_contact"],
        primary=RigidPlane(point=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0)),
        friction=Frictionless(),
    )
    modulus = plane_strain_modulus(YOUNG, POISSON)

    far = far_compliance(RADIUS, YOUNG, POISSON)

    def theory(force: float) -> HertzSphere:
        return HertzSphere(force, RADIUS, modulus, far)

    return Scene("ball on plane", bodies, V, a, L, bcs, pair, h, approach, 4, theory)


def two_spheres(
    comm: MPI.Comm,
    h: float = 0.08,
    *,
    h_lower: float | None = None,
    degree: int = 1,
    approach: float = 0.1,
) -> Scene:
    """Return two balls, octants with cells of size h and h_lower [mm] (or 1.3 h) at the contact.

    The meshes do not match, so the package takes mortar elements.
    """
    h_lower = 1.3 * h if h_lower is None else h_lower
    radius = 1 / (1 / RADIUS + 1 / LOWER_RADIUS)
    contact = math.sqrt(radius * approach)
    bodies = read_gmsh(
        MESHES / "sphere_octant.geo",
        comm,
        Bodies=2,
        R=RADIUS,
        R_lower=LOWER_RADIUS,
        h=h,
        h_lower=h_lower,
        Zone=1.4 * contact,
    )
    V, a, L = elasticity(
        bodies,
        degree,
        {"upper": (YOUNG, POISSON), "lower": (LOWER_YOUNG, LOWER_POISSON)},
    )
    bcs = [
        fix(V, bodies, "upper_x", 0),
        fix(V, bodies, "upper_y", 1),
        fix(V, bodies, "upper_cut", 2, -approach),
        fix(V, bodies, "lower_x", 0),
        fix(V, bodies, "lower_y", 1),
        fix(V, bodies, "lower_cut", 2),
    ]
    pair = ContactPair(
        bodies.facet_tags,
        secondary=bodies.tags["upper_contact"],
        primary=bodies.tags["lower_contact"],
        friction=Frictionless(),
    )
    modulus = 1 / (
        1 / plane_strain_modulus(YOUNG, POISSON)
        + 1 / plane_strain_modulus(LOWER_YOUNG, LOWER_POISSON)
    )

    far = far_compliance(RADIUS, YOUNG, POISSON) + far_compliance(
        LOWER_RADIUS, LOWER_YOUNG, LOWER_POISSON
    )

    def theory(force: float) -> HertzSphere:
        return HertzSphere(force, radius, modulus, far)

    cell = max(h, h_lower)
    return Scene("two balls", bodies, V, a, L, bcs, pair, cell, approach, 4, theory)


def cylinder_on_plane(
    comm: MPI.Comm,
    h: float = 0.06,
    *,
    degree: int = 1,
    approach: float = 0.2165,
    quadrilaterals: bool = False,
) -> Scene:
    """Return a long cylinder on a rigid plane: a quarter of its section, in plane strain."""
    contact = 0.12 * RADIUS  # about
    bodies = read_gmsh(
        MESHES / "half_disc.geo",
        comm,
        R=RADIUS,
        h=h,
        Zone=1.3 * contact,
        Arc=2.5 * contact,
        Quad=int(quadrilaterals),
    )
    V, a, L = elasticity(bodies, degree, {"cylinder": (YOUNG, POISSON)})
    bcs = [fix(V, bodies, "symmetry", 0), fix(V, bodies, "cut", 1, -approach)]
    pair = ContactPair(
        bodies.facet_tags,
        secondary=bodies.tags["contact"],
        primary=RigidPlane(point=(0.0, 0.0), normal=(0.0, 1.0)),
        friction=Frictionless(),
    )
    modulus = plane_strain_modulus(YOUNG, POISSON)

    def theory(force: float) -> HertzLine:
        return HertzLine(force, RADIUS, modulus)

    return Scene("cylinder on plane", bodies, V, a, L, bcs, pair, h, approach, 2, theory)


def elasticity(
    bodies: TaggedMesh, degree: int, materials: dict[str, tuple[float, float]]
) -> tuple[Any, Any, Any]:
    """Return space and forms for bodies with (Young's modulus, Poisson's ratio) by name."""
    mesh = bodies.mesh
    V = fem.functionspace(mesh, ("Lagrange", degree, (mesh.geometry.dim,)))
    constants = fem.functionspace(mesh, ("DG", 0))
    young, poisson = fem.Function(constants), fem.Function(constants)
    for name, values in materials.items():
        cells = bodies.cell_tags.find(bodies.tags[name])
        young.x.array[cells], poisson.x.array[cells] = values
    mu = young / (2 * (1 + poisson))
    lame = young * poisson / ((1 + poisson) * (1 - 2 * poisson))

    def strain(u: Any) -> Any:
        return ufl.sym(ufl.grad(u))

    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    a = (2 * mu * ufl.inner(strain(u), strain(v)) + lame * ufl.div(u) * ufl.div(v)) * ufl.dx
    L = ufl.inner(fem.Constant(mesh, np.zeros(mesh.geometry.dim)), v) * ufl.dx
    return V, a, L


def fix(V: Any, bodies: TaggedMesh, name: str, component: int, value: float = 0.0) -> Any:
    """Return the condition that a component of u has this value on a surface."""
    facets = bodies.facet_tags.find(bodies.tags[name])
    dofs = fem.locate_dofs_topological(V.sub(component), bodies.facet_tags.dim, facets)
    return fem.dirichletbc(value, dofs, V.sub(component))


# %% [markdown]
# ## Solve
# The displacement is prescribed, the force is an outcome: the integral of the pressure. Hertz's
# radius and pressure for this force are what the computed ones must be. The nodes are all on the
# upper body, whose surface is almost flat at the contact.


# %%
@dataclass(frozen=True)
class Comparison:
    """Computed contact and what Hertz says to its force; the same on all ranks."""

    theory: HertzSphere | HertzLine
    r: np.ndarray  # mm, distances of the contact nodes from the middle
    p: np.ndarray  # MPa, their pressures
    contact_radius: float  # mm, of a disc as large as the area of the nodes that are pressed
    peak: float  # MPa, the largest pressure
    approach: float  # mm
    difference: float  # root mean square of p - theory, relative to that of theory

    def __str__(self) -> str:
        rows = [
            ("contact radius [mm]", self.contact_radius, self.theory.contact_radius),
            ("peak pressure [MPa]", self.peak, self.theory.peak),
            ("approach [mm]", self.approach, self.theory.approach),
        ]
        lines = [f"{'force [N, N/mm]':<22}{self.theory.force:<10.4g}"]
        for name, found, hertz in rows:
            lines.append(f"{name:<22}{found:<10.4g}Hertz {hertz:<10.4g}{found / hertz - 1:+.1%}")
        lines.append(f"{'pressures differ by':<22}{self.difference:.1%}, root mean square")
        return "\n".join(lines)


def solve(scene: Scene) -> ContactSolution:
    """Solve."""
    with ContactProblem(scene.a, scene.L, [scene.pair], bcs=scene.bcs, units=UNITS) as problem:
        return problem.solve(rtol=1e-6)  # pressures are compared node by node


def compare(scene: Scene, solution: ContactSolution) -> Comparison:
    """Return the computed contact beside the theory of its force. Collective."""
    comm = scene.V.mesh.comm
    surface = solution.surface
    space = surface.pressure.function_space
    owned = space.dofmap.index_map.size_local
    horizontal = scene.V.mesh.geometry.dim - 1
    nodes = np.linalg.norm(space.tabulate_dof_coordinates()[:owned, :horizontal], axis=1)
    r = np.concatenate(comm.allgather(nodes))
    p = np.concatenate(comm.allgather(surface.pressure.x.array[:owned]))
    pressed = comm.allreduce(float(surface.weights[surface.touching].sum()))
    theory = scene.theory(scene.share * solution.normal_force)
    # the area of all parts together is a disc, or a strip
    if isinstance(theory, HertzSphere):
        contact_radius = math.sqrt(scene.share * pressed / math.pi)
    else:
        contact_radius = pressed
    near = r < 2 * theory.contact_radius
    wanted = theory.pressure(r[near])
    difference = np.linalg.norm(p[near] - wanted) / np.linalg.norm(wanted)
    return Comparison(
        theory=theory,
        r=r,
        p=p,
        contact_radius=contact_radius,
        peak=float(p.max()),
        approach=scene.approach,
        difference=float(difference),
    )


# %% [markdown]
# ## Check
# What may differ, and why. Hertz neglects a/R squared. On the mesh the edge of the contact lies
# between two nodes, so the radius is uncertain by a cell. At the edge the pressure falls steeply,
# like a square root, which the mesh smears over one ring of cells: as root mean square that makes
# some h/a of the pressure. In the middle the pressure is smooth, and a part of that is enough.


# %%
def check(scene: Scene, solution: ContactSolution, found: Comparison) -> None:
    """Assert what must hold: convergence, the contact law, and Hertz."""
    solution.raise_if_failed()
    surface, comm = solution.surface, scene.V.mesh.comm
    gap = comm.allreduce(surface.gap.x.array.min(initial=np.inf), op=MPI.MIN)
    assert found.p.min() >= 0.0
    assert gap >= -1e-4 * scene.approach  # the residual of 1e-6 is that of mean squares
    # the contact ends within the surface that was given to the package, to the same residual
    beyond = found.p[found.r > 1.3 * found.theory.contact_radius]
    assert beyond.max(initial=0.0) <= 1e-3 * found.peak

    neglected = (found.theory.contact_radius / found.theory.radius) ** 2
    cell = scene.h / found.theory.contact_radius
    assert abs(found.contact_radius / found.theory.contact_radius - 1) < cell + neglected
    assert abs(found.peak / found.theory.peak - 1) < 0.4 * cell + neglected
    assert abs(found.approach / found.theory.approach - 1) < 0.3 * cell + neglected
    assert found.difference < cell + neglected


# %% [markdown]
# ## Draw
# The pressure of each node over its distance from the middle, and Hertz's curve. Quadratic
# displacements on cells twice as large are closer to it than linear ones. The latter show a row of
# nodes a little below the others: those on a plane of symmetry, where the regular grid of
# tetrahedra meets its mirror image.


# %%
def draw(path: Path, comparisons: dict[str, dict[int, Comparison]]) -> None:
    """Save a picture with a panel for each scene and a set of points for each degree.

    On one rank only.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(
        1,
        len(comparisons),
        figsize=(8.8, 3.0),
        layout="constrained",
        squeeze=False,
        sharey=True,
    )
    ends = 1.4
    x = np.linspace(0, ends, 1000)
    for panel, (name, degrees) in zip(panels[0], comparisons.items(), strict=True):
        panel.plot(x, np.sqrt(np.maximum(1 - x**2, 0)), color="black", lw=1, label="Hertz")
        for (degree, found), style in zip(degrees.items(), (".", "o"), strict=False):
            place = found.r / found.theory.contact_radius
            panel.plot(
                place[place < ends],
                found.p[place < ends] / found.theory.peak,
                style,
                ms=4,
                label=f"nodes, degree {degree}",
            )
        panel.set_title(name, fontsize=11)
        panel.set(xlabel="distance from the middle / Hertz's radius", ylim=(0, 1.1))
        panel.xaxis.label.set_size(9)
        panel.set_xticks([0, 0.5, 1])
        panel.spines[["top", "right"]].set_visible(False)
    panels[0][0].set_ylabel("pressure / Hertz's peak", fontsize=9)
    panels[0][0].legend(loc="lower left", frameon=False, fontsize=9)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=200)
    plt.close(figure)


def main() -> None:
    """Run the demo."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    comm = MPI.COMM_WORLD
    comparisons: dict[str, dict[int, Comparison]] = {}
    for build, h in ((sphere_on_plane, 0.12), (two_spheres, 0.08), (cylinder_on_plane, 0.06)):
        for degree in (1, 2):
            scene = build(comm, degree * h, degree=degree)
            solution = solve(scene)
            found = compare(scene, solution)
            if comm.rank == 0:
                print(f"\n{scene.name}, degree {degree}\n{solution}\n{found}\n")
            check(scene, solution, found)
            comparisons.setdefault(scene.name, {})[degree] = found
            if build is sphere_on_plane and degree == 1:
                solution.write(RESULTS / "hertz_ball.pvd")
                solution.plot(RESULTS / "hertz_ball.png", scale=1)
    if comm.rank == 0:
        draw(RESULTS / "hertz.png", comparisons)


if __name__ == "__main__":
    main()
