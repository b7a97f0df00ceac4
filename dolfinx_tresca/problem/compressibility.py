"""Bodies that hardly change their volume: elements of displacements alone are unstable there."""

from __future__ import annotations

import numpy as np

from dolfinx import fem

from dolfinx_tresca.floating.bodies import Bodies
from dolfinx_tresca.problem.tangent_system import TangentSystem

#: Poisson's ratio from which on an unstable body is said to be hardly compressible. (A ball that is
#: pressed into a layer of degree 2, two cells thick, gets as deep as 0.4 of the thickness with 0.45
#: and 0.49, 0.5 with 0.4, and 0.7 with 0.49 and a pressure as a further unknown.)
HARDLY_COMPRESSIBLE = 0.45


def poisson_ratios(tangent: TangentSystem, bodies: Bodies) -> list[float]:
    """Return a mean Poisson's ratio of each body, from the assembled tangent. Collective.

    The energies of a uniform expansion and of a distortion without change of volume give it:
    their ratio is 1 + lambda / mu in plane strain, and (3 lambda + 2 mu) / (4 mu) in space and with
    an axis of revolution.

    Args:
        tangent: tangent of undeformed bodies, which is assembled.
        bodies: the bodies of the mesh.
    """
    V = tangent.V
    dim = V.mesh.geometry.dim
    is_plane = dim == 2 and not tangent.axisymmetric
    stretch = np.ones(dim)
    stretch[-1] = -1.0 if is_plane else -2.0
    points = V.tabulate_dof_coordinates()[: len(bodies.label), :dim]
    result = []
    for body in range(bodies.number):
        energies = []
        for factors in (np.ones(dim), stretch):
            v = fem.Function(V)
            moved = np.where((bodies.label == body)[:, None], factors * points, 0.0)
            v.x.array[: moved.size] = moved.ravel()
            v.x.scatter_forward()
            energies.append(tangent.strain_energy(v.x.petsc_vec))
        ratio = energies[0] / energies[1] if energies[1] > 0.0 else 0.0
        lame = max(ratio - 1.0 if is_plane else (4.0 * ratio - 2.0) / 3.0, 0.0)  # lambda / mu
        result.append(lame / (2.0 * (lame + 1.0)))
    return result
