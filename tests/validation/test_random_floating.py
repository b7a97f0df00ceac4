"""Random scenes of bodies that contact holds, as they are and turned, fresh and after other loads.

Which loads can be balanced, and what the displacement is, comes from an interior-point method.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

from mpi4py import MPI

import clarabel
import numpy as np
import pytest
from conic import conic_minimum

import ufl
from dolfinx import fem

from dolfinx_tresca import (
    Bonded,
    ContactPair,
    ContactProblem,
    ContactSolution,
    ContactStatus,
    Coulomb,
    Frictionless,
    InputError,
    RigidPlane,
    Tresca,
)
from dolfinx_tresca.pairing.operators import PairOperators
from scenes.patches import BOTTOM, KINDS, LOWER_BLOCK, TOP, UPPER_BLOCK, dim_of, patch
from scenes.scene import Scene

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="each scene is one rank's")

#: Loads over the largest that can be balanced: inside, outside, far inside; and where that ends.
INSIDE, OUTSIDE, TINY, UNLIMITED = 0.9, 1.1, 1e-9, 10.0

#: Below this none can.
NONE = 1e-4

#: Asked for, in the energy norm, and what clarabel leaves, but where springs are soft.
ACCURACY, REFERENCE, STIFF = 1e-4, 1e-4, 1.0

#: Requested residual with Coulomb's law, whose fixed point the energy norm does not tell;
#: and where a gap of a thousandth of the size is 1e9 times what loads move.
RTOL, RTOL_OF_TINY = 1e-7, 1e-4

#: Springs that hold bodies which friction does not, over the largest stiffness: with a hundredth of
#: that they slide a hundred times as far, about; others hardly farther. Tresca problems until the
#: pressures settle, and to which part they do.
HOLDING, FARTHER, SWEEPS, SETTLED = 1e-5, 30.0, 60, 1e-6

#: How an iteration ends that finds no solution, and how many of fifty scenes may end so though
#: there is one. With Coulomb's law two of a thousand do, whose bodies slide on soft springs; with
#: given slip bounds scene 528 does at 0.9 of its limit load, and scenes 20 and 40, where bodies
#: slide on soft springs by far more than they deform.
MISSES, MISSED = (ContactStatus.NO_FIXED_POINT, ContactStatus.STAGNATED), 2

#: How an iteration ends that finds a solution. Loads are random: some turn bodies on soft springs
#: by many radians, where the discrete problem, but not linear theory, has an answer.
SOLVED = (ContactStatus.CONVERGED, ContactStatus.OUTSIDE_THEORY)

#: Of Clarabel.
TOLERANCE = 1e-10
#: Gaps over what the load moves, beyond which an interior-point method has trouble with them.
WIDE = 1e6


@dataclass
class Floating:
    """Two blocks, one on the other; the lower one is held or stands on a rigid floor.

    Attributes:
        pairs: blocks, and the floor's.
        load: on the top and the lower block, `directions` times a factor.
        directions: unit vectors of the traction and of the body force, by their size.
        free: the tags of the blocks that nothing but contact holds.
        springs: stiffness per volume that holds the upper block, over a modulus of 1000.
    """

    scene: Scene
    pairs: list[ContactPair]
    load: list[fem.Constant]
    directions: list[np.ndarray]
    free: list[int]
    springs: float
    turn: np.ndarray

    def problem(self) -> ContactProblem:
        """Return the problem."""
        return self.scene.problem(pairs=self.pairs, stiffness="cholesky")

    def scale(self, factor: float) -> None:
        """Set the loads."""
        for constant, direction in zip(self.load, self.directions, strict=True):
            constant.value = factor * direction

    def operators(self) -> list[PairOperators]:
        """Return N, T and the gap of the pairs."""
        return [self.scene.operators(pair) for pair in self.pairs]


def floating_scene(seed: int, turned: bool, coulomb: bool = False) -> Floating:
    """Return a random scene, as it is or turned; with Coulomb's law in the place of Tresca's."""
    rng = np.random.default_rng(seed)
    kind = str(rng.choice(KINDS))
    dim = dim_of(kind)
    most = 5 if dim == 2 else 3
    turn, _ = np.linalg.qr(rng.standard_normal((dim, dim)))
    turn[:, 0] *= np.sign(np.linalg.det(turn))
    turn = turn if turned else np.eye(dim)
    bounds = 10.0 ** rng.uniform(-2.0, 1.0, 2)
    rubs, rubs_below = (
        Coulomb(0.1 * math.cbrt(100.0 * bound)) if coulomb else Tresca(float(bound))
        for bound in bounds
    )
    law = [rubs, Bonded(), Frictionless()][rng.choice(3, p=[0.7, 0.15, 0.15])]
    springs = 10.0 ** rng.uniform(-5.0, 2.0) * (isinstance(law, Frictionless) or rng.random() < 0.2)
    start = rng.uniform(-0.4, 0.4) * (rng.random() < 0.5)
    scene = patch(
        MPI.COMM_SELF,
        kind,
        int(rng.choice([1, 2], p=[0.8, 0.2])) if dim == 2 else 1,
        upper=(int(rng.integers(1, most + 1)), 1),
        lower=(int(rng.integers(1, most + 1)), 1),
        span=[(start, start + rng.uniform(0.6, 1.3)), (0.0, 1.0)][: dim - 1],
        gap=float(rng.choice([0.0, 1e-3])),
        turn=turn,
        friction=law,
        pairing=str(rng.choice(["auto", "mortar"])),
    )
    stands = rng.random() < 0.5
    pairs = [scene.pair]
    if stands:
        up = np.append(turn[:, -1], np.zeros(3 - dim))
        plane = RigidPlane(np.zeros(3), up)
        pairs.append(ContactPair(scene.facet_tags, BOTTOM, plane, rubs_below))
    u, v = ufl.TrialFunction(scene.V), ufl.TestFunction(scene.V)
    cells = ufl.Measure("dx", domain=scene.mesh, subdomain_data=scene.cell_tags)
    facets = ufl.Measure("ds", domain=scene.mesh, subdomain_data=scene.facet_tags)
    load = [fem.Constant(scene.mesh, np.zeros(dim)) for _ in range(2)]
    down = [np.append(rng.uniform(-0.3, 0.3, dim - 1), sign) for sign in (-1.0, -0.5)]
    if rng.random() < 0.1:
        down[0] *= -1.0  # lifts it off
    L = ufl.inner(load[0], v) * facets(TOP) + ufl.inner(load[1], v) * cells(LOWER_BLOCK)
    a = scene.a
    if springs:
        stiffness = fem.Function(fem.functionspace(scene.mesh, ("DG", 0)))
        stiffness.x.array[scene.cell_tags.find(UPPER_BLOCK)] = springs
        a = a + stiffness * ufl.inner(u, v) * ufl.dx
    held = fem.locate_dofs_topological(scene.V, dim - 1, scene.facet_tags.find(BOTTOM))
    fixed = fem.dirichletbc(np.zeros(dim), held, scene.V)
    free = [LOWER_BLOCK] * stands + [UPPER_BLOCK] * (not springs)
    return Floating(
        dataclasses.replace(scene, a=a, L=L, bcs=[] if stands else [fixed]),
        pairs,
        load,
        [turn @ one for one in down],
        free,
        springs,
        turn,
    )


class Conic:
    """The scene's matrices, and what an interior-point method makes of them."""

    def __init__(self, scene: Floating) -> None:
        V = scene.scene.V
        self.scene, self.dim = scene, V.mesh.geometry.dim
        self.K = fem.assemble_matrix(fem.form(scene.scene.a)).to_dense()
        self.form = fem.form(scene.scene.L)
        self.held = np.zeros(len(self.K), dtype=bool)
        for bc in scene.scene.bcs:
            self.held[bc.dof_indices()[0]] = True
        self.operators = scene.operators()

    def loads(self) -> np.ndarray:
        """Return f of the present loads."""
        return np.where(self.held, 0.0, fem.assemble_vector(self.form).array)

    def blocks(self):
        """Yield the jump (rows, dofs), gap, friction and kind of each cone.

        Friction is a bound [force], a coefficient, and the row of the normal force it multiplies.
        """
        first = 0
        for pair, one in zip(self.scene.pairs, self.operators, strict=True):
            N, T = (block.toarray()[:, : len(self.K)] * ~self.held for block in (one.N, one.T))
            weights = one.weights
            if one.bonded:
                rows = np.vstack([N, T])
                yield rows, np.append(one.gap[one.normal_node], np.zeros(len(T))), None, "bonded"
            else:
                yield N, one.gap[one.normal_node], None, "normal"
                for node in range(len(one.nodes)):
                    rows = T[one.tangent_node == node]
                    if len(rows):
                        terms = pair.friction.terms
                        (row,) = first + np.flatnonzero(one.normal_node == node)
                        friction = (terms.constant * weights[node], terms.coefficient, row)
                        yield rows, np.zeros(len(rows)), friction, "disc"
            first += len(N) + len(T)

    def forces(self, solution: ContactSolution) -> np.ndarray:
        """Return the nodal contact forces: stresses times areas, pressures before tractions."""
        areas = []
        for one in self.operators:
            areas += [one.weights[one.normal_node], one.weights[one.tangent_node]]
        return solution.multipliers * np.concatenate(areas)

    def motions(self) -> np.ndarray:
        """Return the rigid motions (dofs, k) of the free blocks."""
        V, tags = self.scene.scene.V, self.scene.scene.cell_tags
        x = V.tabulate_dof_coordinates()[:, : self.dim]
        columns = []
        for tag in self.scene.free:
            nodes = np.unique(V.dofmap.list[tags.find(tag)])
            for i in range(self.dim):
                columns.append(np.zeros_like(x))
                columns[-1][nodes, i] = 1.0
            for i in range(self.dim):
                for j in range(i):
                    columns.append(np.zeros_like(x))
                    columns[-1][nodes, i], columns[-1][nodes, j] = x[nodes, j], -x[nodes, i]
        return np.array([column.ravel() for column in columns]).reshape(-1, x.size).T

    def limit(self) -> float | None:
        """Return how often the loads can be balanced, up to `UNLIMITED`: max t, t f = B'lambda.

        None where clarabel does not find it.
        """
        f, R = self.loads(), self.motions()
        size = np.abs(f).sum()
        parts = list(self.blocks())
        B = np.vstack([rows for rows, *_ in parts])
        m = len(B)
        blocks = [np.column_stack([R.T @ f / size, -R.T @ B.T]), np.eye(1, 1 + m)]
        right, cones = (
            [np.zeros(R.shape[1]), [UNLIMITED]],
            [clarabel.ZeroConeT(R.shape[1]), clarabel.NonnegativeConeT(1)],
        )
        first = 1
        for rows, _, friction, kind in parts:
            own = np.eye(1 + m)[first : first + len(rows)]
            first += len(rows)
            if kind == "normal":
                blocks.append(-own)
                right.append(np.zeros(len(rows)))
                cones.append(clarabel.NonnegativeConeT(len(rows)))
            elif kind == "disc":
                bound, coefficient, row = friction
                blocks.append(np.vstack([-coefficient * np.eye(1 + m)[1 + row], -own]))
                right.append(np.append(bound / size, np.zeros(len(rows))))
                cones.append(clarabel.SecondOrderConeT(1 + len(rows)))
        cost = -np.eye(1, 1 + m)[0]
        no_square = np.zeros((1 + m, 1 + m))
        found = conic_minimum(no_square, cost, blocks, right, cones, TOLERANCE)
        return float(found.x[0]) if str(found.status) == "Solved" else None

    def displacement(self, forces: np.ndarray) -> np.ndarray | None:
        """Return u that minimises the energy; None where clarabel does not find it.

        Args:
            forces: of contact; slip bounds are those of their pressures.
        """
        u, _, status = self._minimum(forces)
        return u if status == "Solved" else None

    def check(self, solution: ContactSolution) -> None:
        """Compare a solution with the minimiser of the energy, unless springs are soft."""
        soft = 0.0 < self.scene.springs <= STIFF
        reference = None if soft else self.displacement(self.forces(solution))
        u = solution.u.x.array
        assert reference is None or self.distance(u, reference) <= ACCURACY + REFERENCE

    def slides(self) -> bool:
        """Return whether friction, with the bounds of its own pressures, lets free blocks slide.

        That is not told by limits: friction forces obey no principle of maximal plastic work.
        """
        free = self.motions().any(axis=1)
        reached = []
        for springs in (HOLDING, 0.01 * HOLDING):
            forces = np.zeros(sum(len(rows) for rows, *_ in self.blocks()))
            for _ in range(SWEEPS):
                before, (u, forces, status) = forces, self._minimum(forces, springs)
                if status not in ("Solved", "AlmostSolved"):
                    return False
                if np.abs(forces - before).max() <= SETTLED * np.abs(forces).max():
                    break
            reached.append(np.abs(u[free]).max(initial=0.0))
        return reached[1] > FARTHER * reached[0]

    def _minimum(
        self, forces: np.ndarray, springs: float = 0.0
    ) -> tuple[np.ndarray, np.ndarray, str]:
        """Return u that minimises the energy, normal forces, and what clarabel says of them.

        Args:
            forces: of contact; slip bounds are those of their pressures.
            springs: at each node of the free blocks, over the largest stiffness.
        """
        f = self.loads()
        stiff = np.abs(np.diag(self.K)).max()
        unit = np.abs(f).max() * 10.0 / stiff
        parts = list(self.blocks())
        n = len(f)
        slips = sum(kind == "disc" for *_, kind in parts)
        P, q = np.zeros((n + slips, n + slips)), np.zeros(n + slips)
        K = self.K / stiff + springs * np.diag(self.motions().any(axis=1))
        P[:n, :n] = np.where(np.outer(~self.held, ~self.held), K, 0.0)
        q[:n] = -f / (stiff * unit)
        blocks, right = [np.eye(n, n + slips)[self.held]], [np.zeros(self.held.sum())]
        cones, slot = [clarabel.ZeroConeT(int(self.held.sum()))], n
        for rows, gap, friction, kind in parts:
            block = np.hstack([rows, np.zeros((len(rows), slips))])
            if kind == "disc":
                bound, coefficient, row = friction
                q[slot] = (bound + coefficient * max(forces[row], 0.0)) / (stiff * unit)
                top = np.zeros(n + slips)
                top[slot] = -1.0
                block = np.vstack([top, -block])
                cones.append(clarabel.SecondOrderConeT(1 + len(rows)))
                gap, slot = np.append(0.0, gap), slot + 1
            else:
                cone = clarabel.ZeroConeT if kind == "bonded" else clarabel.NonnegativeConeT
                cones.append(cone(len(rows)))
            blocks.append(block)
            right.append(np.minimum(gap / unit, WIDE))
        size = np.abs(q).max()
        found = conic_minimum(P / size, q / size, blocks, right, cones, TOLERANCE)
        duals = np.array(found.z)
        pressing, row, dual = np.zeros_like(forces), 0, len(right[0])
        for (rows, *_, kind), block in zip(parts, blocks[1:], strict=True):
            if kind == "normal":
                pressing[row : row + len(rows)] = size * stiff * unit * duals[dual:][: len(rows)]
            row, dual = row + len(rows), dual + len(block)
        return unit * np.array(found.x)[:n], pressing, str(found.status)

    def distance(self, u: np.ndarray, v: np.ndarray) -> float:
        """Return the distance of u and v in the energy norm, over that of v."""
        return float(np.sqrt(max((u - v) @ self.K @ (u - v), 0.0) / (v @ self.K @ v)))


def why_none_is_found(conic: Conic, coulomb: bool) -> str:
    """Return in a word why Coulomb's law has no solution, or that one was missed.

    With given slip bounds there is one for each load below the limit.
    """
    return "slides" if coulomb and conic.slides() else "missed"


def agrees_with_a_fresh_solve(
    scene: Floating, conic: Conic, solution: ContactSolution, asked: dict[str, float]
) -> bool:
    """Compare a solution with a new problem's, and this one with the reference.

    Returns:
        False if the new problem finds no solution.
    """
    with scene.problem() as fresh:
        other = fresh.solve(**asked)
    if other.status in MISSES:
        return False
    assert other.status in SOLVED
    assert conic.distance(solution.u.x.array, other.u.x.array) <= 2.0 * ACCURACY
    conic.check(other)
    return True


def check(seed: int, coulomb: bool = False) -> str:
    """Check a scene; return which loads are balanced, in a word."""
    asked = {"rtol": RTOL} if coulomb else {"accuracy": ACCURACY}
    found = []
    for turned in (False, True):
        scene = floating_scene(seed, turned, coulomb)
        scene.scale(1.0)
        conic = Conic(scene)
        limit = conic.limit() if scene.free else UNLIMITED
        if limit is None:
            return "unknown"
        limited = limit < 0.99 * UNLIMITED
        balanced = limit > NONE
        largest = limit if balanced and limited else 1.0
        gap = max(np.abs(one.gap).max() for one in conic.operators) > 1e-6
        with scene.problem() as warm:
            for factor in (0.3, 0.0, TINY, 0.6, OUTSIDE, INSIDE):
                if coulomb and factor == TINY and gap:
                    continue  # nothing but rounding of it is left of such loads
                scene.scale(factor * largest)
                if factor > 0.0 and (not balanced or (limited and factor > 1.0)):
                    with pytest.raises(InputError, match="no contact forces balance"):
                        warm.solve()
                    continue
                rough = {"rtol": RTOL_OF_TINY} if coulomb and factor == TINY else {}
                solution = warm.solve(**{**asked, **rough})
                if solution.status in MISSES:
                    return why_none_is_found(conic, coulomb)
                assert solution.status in SOLVED, (turned, factor)
                assert factor > 0.0 or not solution.u.x.array.any()
                if factor > TINY and not agrees_with_a_fresh_solve(scene, conic, solution, asked):
                    return why_none_is_found(conic, coulomb)
        if not balanced:
            found.append((conic, None))
            continue
        u = solution.u.x.array
        found.append((conic, u.reshape(-1, conic.dim) @ scene.turn))
    (conic, plain), (_, back) = found
    assert (plain is None) == (back is None)
    if plain is None or back is None:
        return "refused"
    assert conic.distance(back.ravel(), plain.ravel()) <= 2.0 * ACCURACY
    return "limited" if limited else "unlimited"


# Scene 29: nothing touches, and rounding of the equilibrium is no pressure. Scene 723 needs a
# second iteration, since its fields miss the accuracy that the iterate had. Scene 147, solved from
# zero, ends out of balance by 0.6 %, and must not be called solved for its small error bound.
@pytest.mark.parametrize("seed", [0, 1, 3, 4, 29, 147, 723])
def test_scenes_agree(seed):
    assert check(seed) != "missed"


# Scene 40: bodies on springs of very different stiffness, without a solution unless their
# multipliers are refined. With the arithmetic of old processors it is lost (`make test-cores`).
@pytest.mark.parametrize("seed", [3, 11, 40, 47])
def test_scenes_agree_with_coulomb(seed):
    assert check(seed, coulomb=True) != "missed"


def test_friction_that_cannot_hold_a_body_is_told():
    """Limit analysis finds forces that balance the loads, but they come with other motions."""
    assert check(17, coulomb=True) == "slides"


def test_a_small_load_far_from_the_floor():
    """Soft springs hold a body; times the gap, a pressure of rounding is more work than the load's.

    The load is 1e-9 of what would close the gap.
    """
    scene = floating_scene(376, turned=False)
    scene.scale(1e-9)
    with scene.problem() as problem:
        solution = problem.solve(accuracy=ACCURACY)
    assert solution.status in SOLVED
    assert solution.counts.contact == 0


@pytest.mark.parametrize(
    ("seed", "factors"), [(992, (0.3, 0.0, TINY, 0.6)), (982, (0.0, TINY, 0.0))]
)
def test_what_errors_leave_of_known_pairs_is_not_new(seed, factors):
    """Multigrid: of 10 unknowns 47 pairs were kept once, of 30 unknowns 137, in one step each."""
    scene = floating_scene(seed, turned=False)
    with scene.scene.problem(pairs=scene.pairs, stiffness="multigrid") as problem:
        for factor in factors:
            scene.scale(factor)
            solution = problem.solve(accuracy=ACCURACY)
            assert solution.status in SOLVED
            assert solution.products <= len(solution.multipliers)


@pytest.mark.long
@pytest.mark.parametrize("coulomb", [False, True])
@pytest.mark.parametrize("first", range(0, 1000, 50))
def test_a_thousand_scenes_agree(first, coulomb):
    missed = []
    for seed in range(first, first + 50):
        try:
            if check(seed, coulomb) == "missed":
                missed.append(seed)
        except Exception as error:
            raise AssertionError(f"scene {seed}: {error}") from error
    assert len(missed) <= MISSED, missed
