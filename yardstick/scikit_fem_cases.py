"""Solve two cases of the yardstick by scikit-fem, as an example of a program that is measured.

    pip install scikit-fem
    python3 yardstick/scikit_fem_cases.py > yardstick/answers/scikit_fem.json

scikit-fem has no contact algorithm: meshes, elements and assembly are its own, and a semismooth
Newton method on displacements and nodal contact forces (Alart and Curnier 1991) is added here, with
SciPy's sparse LU factorisation. Data of the cases are in `cases/shrink_fit.json` and
`cases/pushed_block.json`.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import skfem
from scipy.sparse import bmat, csr_matrix, diags
from scipy.sparse.linalg import spsolve
from skfem.models.elasticity import lame_parameters, linear_elasticity

#: Newton steps after which a solve has failed.
MOST_STEPS = 50


@dataclass
class ContactNodes:
    """What touches: a row of each matrix for each contact node.

    Attributes:
        normal: (m, n) matrix from the displacement to the approach of the sides.
        tangential: (m, n) matrix from the displacement to the slip.
        gap: (m,) distances of the sides.
        weights: (m,) lengths of surface that belong to the nodes.
    """

    normal: csr_matrix
    tangential: csr_matrix
    gap: np.ndarray
    weights: np.ndarray


def solve(
    stiffness: csr_matrix,
    load: np.ndarray,
    fixed: np.ndarray,
    contact: ContactNodes,
    friction: float,
    young: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the displacement (n,), and normal (m,) and tangential (m,) forces of the nodes.

    Args:
        stiffness: (n, n) matrix.
        load: (n,) forces.
        fixed: numbers of the displacements that are zero.
        contact: the contact nodes.
        friction: Coulomb's coefficient of friction.
        young: Young's modulus, the scale between displacements and forces.
    """
    free = np.setdiff1d(np.arange(len(load)), fixed)
    K, N, T = stiffness[free][:, free], contact.normal[:, free], contact.tangential[:, free]
    m = len(contact.gap)
    touching, slipping, sign = np.ones(m, bool), np.full(m, friction == 0.0), np.zeros(m)
    for _ in range(MOST_STEPS):
        sticking = touching & ~slipping
        on, stick = diags(touching * 1.0), diags(sticking * 1.0)
        matrix = bmat(
            [
                [K, N.T, T.T],
                [on @ N, diags(1.0 - touching), None],
                [stick @ T, diags(-friction * sign * (touching & slipping)), diags(1.0 - sticking)],
            ],
            format="csc",
        )
        unknowns = spsolve(
            matrix, np.concatenate([load[free], touching * contact.gap, np.zeros(m)])
        )
        u, p, q = np.split(unknowns, [len(free), len(free) + m])
        trial = q + young * (T @ u)
        states = (
            p + young * (N @ u - contact.gap) > 0.0,
            abs(trial) > friction * p if friction else np.ones(m, bool),
            np.sign(trial),
        )
        same = np.array_equal(states[0], touching) and np.array_equal(
            states[1] & touching, slipping & touching
        )
        touching, slipping, sign = states
        if same:
            displacement = np.zeros(len(load))
            displacement[free] = u
            return displacement, p, q
    raise RuntimeError("Newton's method has not converged")


def block(x: np.ndarray, y: np.ndarray, move: Callable[[Any, Any], Any]) -> skfem.MeshQuad:
    """Return a mesh of a moved rectangle whose sides keep their names."""
    mesh = skfem.MeshQuad.init_tensor(x, y).with_defaults()
    return skfem.MeshQuad(np.array(move(*mesh.p)), mesh.t).with_boundaries(mesh.boundaries)


def along_side(basis: skfem.CellBasis, side: str, axis: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the displacements (m, 2) of the nodes of a side in their order, and its weights (m,).

    Args:
        basis: the basis of the displacement.
        side: name of the side.
        axis: the coordinate along which nodes are sorted, descending for 1.
    """
    dofs = [basis.get_dofs(side).all(f"u^{k}") for k in (1, 2)]
    orders = [np.argsort(basis.doflocs[axis, each] * (1 - 2 * axis)) for each in dofs]
    numbers = np.stack([each[order] for each, order in zip(dofs, orders, strict=True)], axis=1)
    area = skfem.LinearForm(lambda v, _: v[0]).assemble(basis.boundary(side))
    return numbers, area[numbers[:, 0]]


def rows(numbers: np.ndarray, vectors: np.ndarray, columns: int) -> csr_matrix:
    """Return the matrix whose rows multiply displacements of nodes by vectors (m, 2)."""
    row = np.repeat(np.arange(len(numbers)), 2)
    return csr_matrix((vectors.ravel(), (row, numbers.ravel())), (len(numbers), columns))


def shrink_fit(cells: int) -> dict[str, float]:
    """Solve the shrink fit, with meshes that match, of degree 1."""
    interference = 0.02
    element = skfem.ElementVector(skfem.ElementQuad1())
    parts, fixed, sides = [], [], []
    for inner, outer, young in ((10.0, 20.0 + interference, 210e3), (20.0, 40.0, 70e3)):
        layers = max(2, round(np.log(outer / inner) / (0.5 * np.pi) * cells))
        mesh = block(
            np.geomspace(inner, outer, layers + 1),
            np.linspace(0.0, 0.5 * np.pi, cells + 1),
            lambda r, angle: (r * np.cos(angle), r * np.sin(angle)),
        )
        basis = skfem.CellBasis(mesh, element)
        parts.append(linear_elasticity(*lame_parameters(young, 0.3)).assemble(basis))
        before = sum(part.shape[0] for part in parts[:-1])
        for side, component in (("bottom", "u^2"), ("top", "u^1")):
            fixed.append(before + basis.get_dofs(side).all(component))
        numbers, weights = along_side(basis, "right" if len(parts) == 1 else "left", 0)
        sides.append((before + numbers, weights))
    (shaft, _), (ring, weights) = sides
    n = sum(part.shape[0] for part in parts)
    angle = np.linspace(0.5 * np.pi, 0.0, cells + 1)  # nodes are sorted by their first coordinate
    normal = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    contact = ContactNodes(
        rows(shaft, normal, n) - rows(ring, normal, n),
        csr_matrix((len(angle), n)),
        np.full(len(angle), -interference),
        weights,
    )
    stiffness = bmat([[parts[0], None], [None, parts[1]]], format="csr")
    _, p, _ = solve(stiffness, np.zeros(n), np.concatenate(fixed), contact, 0.0, 210e3)
    return {"mean pressure [MPa]": p.sum() / weights.sum()}


def pushed_block(cells: int) -> dict[str, float]:
    """Solve the pushed block, with elements of degree 2 and nodal conditions of contact."""
    width, height, young = 4.0, 2.0, 1000.0
    mesh = block(
        np.linspace(0.0, 1.0, cells + 1),
        np.linspace(0.0, 1.0, cells // 2 + 1),
        lambda x, y: (0.5 * width * (1.0 - np.cos(np.pi * x)), height * y**2),
    )
    basis = skfem.CellBasis(mesh, skfem.ElementVector(skfem.ElementQuad2()))
    stiffness = linear_elasticity(*lame_parameters(young, 0.3)).assemble(basis)
    outwards = skfem.LinearForm(lambda v, w: v[0] * w.n[0] + v[1] * w.n[1])
    load = -sum(
        pressure * outwards.assemble(basis.boundary(side))
        for side, pressure in (("top", 100.0), ("left", 80.0))
    )
    numbers, weights = along_side(basis, "bottom", 0)
    ones, n = np.ones((len(numbers), 1)), len(load)
    contact = ContactNodes(
        rows(numbers, ones * [0.0, -1.0], n),
        rows(numbers, ones * [1.0, 0.0], n),
        np.zeros(len(numbers)),
        weights,
    )
    u, p, q = solve(stiffness, load, np.zeros(0, int), contact, 0.5, young)
    x = basis.doflocs[0, numbers[:, 0]]
    left = np.where(np.isclose(x, 0.5 * width), 0.5, x < 0.5 * width)

    def at(px: float, py: float, component: int) -> float:
        places = basis.doflocs[:, basis.nodal_dofs[component]]
        node = np.argmin(np.hypot(places[0] - px, places[1] - py))
        return float(u[basis.nodal_dofs[component, node]])

    middle = np.argmin(abs(x - 0.5 * width))
    return {
        "displacement of the upper left corner, across": at(0.0, height, 0),
        "displacement of the upper right corner, down": -at(width, height, 1),
        "slip of the lower left corner": at(0.0, 0.0, 0),
        "lift of the lower left corner": at(0.0, 0.0, 1),
        "slip at a quarter of the width": float(np.interp(0.25 * width, x, u[numbers[:, 0]])),
        "pressure in the middle": p[middle] / weights[middle],
        "shear stress in the middle": abs(q[middle]) / weights[middle],
        "part of the normal force on the left half": left @ p / p.sum(),
        "part of the friction force on the left half": left @ q / q.sum(),
    }


def main() -> None:
    """Print the answers."""
    about = "Its meshes, elements and assembly; scikit_fem_cases.py has the contact algorithm."
    lines = [
        json.dumps({"case": case.__name__, "size": size, "quantity": name, "value": float(value)})
        for case, sizes in ((shrink_fit, (16, 32, 64)), (pushed_block, (32, 64, 128)))
        for size in sizes
        for name, value in case(size).items()
    ]
    print(f'{{\n "program": "scikit-fem {skfem.__version__}",\n "about": "{about}",\n "rows": [')
    print(",\n".join("  " + line for line in lines), "\n ]\n}", sep="")


if __name__ == "__main__":
    main()
