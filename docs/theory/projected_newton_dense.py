"""The default method in dense numpy: minimise q(x) = x'A x / 2 - b'x over Lambda, (38.4).

In a contact problem a product A d is a linear solve with K; the cost of everything else is small.
"""

from dataclasses import dataclass

import numpy as np


# Stage 0: the feasible set and its projection
@dataclass
class Lambda:
    """Normal multipliers x >= 0, and |x_i| <= g_i for the tangential multipliers x_i of node i."""

    normal: np.ndarray  # (size,) True for normal multipliers
    discs: np.ndarray  # (size, nodes) 1.0 for the tangential multipliers of a node, else 0.0
    g: np.ndarray  # (nodes,) > 0

    def norms(self, y):
        """Return |y_i| for each node."""
        return np.sqrt(self.discs.T @ y**2)

    def project(self, y):
        """Return P(y), the point of Lambda next to y: psi_g of the tangential multipliers."""
        factors = self.g / np.maximum(self.norms(y), self.g)
        return np.where(self.normal, np.maximum(y, 0.0), y * (self.discs @ factors))

    def means(self, v):
        """Return v with the tangential entries of each node replaced by their mean."""
        return np.where(self.normal, v, self.discs @ (self.discs.T @ v / self.discs.sum(axis=0)))


# Stage 1: the block BFGS model of A, from all products so far
class Model:
    """Pairs Y = A W with W'Y = I, and a diagonal D for all other vectors."""

    def __init__(self, A, D):
        self.A, self.D = A, D
        self.W = self.Y = np.empty((len(D), 0))

    def product(self, d):
        """Return A d; the part of d that is new becomes a pair: Gram-Schmidt, x'A y as product."""
        w, y = d, (Ad := self.A @ d)
        for _ in range(2):  # the second pass removes the rounding errors of the first
            known = self.Y.T @ w
            w, y = w - self.W @ known, y - self.Y @ known
        if w @ y > 1e-10 * (d @ Ad):
            self.W = np.column_stack([self.W, w / np.sqrt(w @ y)])
            self.Y = np.column_stack([self.Y, y / np.sqrt(w @ y)])
        return Ad

    def matrix(self):
        """Return M = Y Y' + (I - Y W') s D (I - W Y'), with s <= 1 from the newest pair."""
        w, unknown = self.W[:, -1], np.eye(len(self.D)) - self.W @ self.Y.T
        s = min(1.0, 1.0 / (w @ (self.D * w)))  # the energy w'A w = 1 over what D makes of it
        return self.Y @ self.Y.T + s * (unknown.T * self.D) @ unknown

    def rho(self):
        """Return 1 / sigma_max(A), about, by the largest Ritz value: an eigenvalue of Y'Y."""
        return 1.0 / np.linalg.norm(self.Y, 2) ** 2


# Stage 2: Newton's method for x = P(x - rho r) with the model, without a product with A
def minimum_of_model(M, x, r, lam):
    """Return the z in Lambda that minimises r'(z - x) + (z - x)'M (z - x) / 2."""
    D = lam.means(np.diag(M))
    rho = 0.2 / D  # a step length for each node

    def gradient(z):
        return r + M @ (z - x)

    def residual(z):
        z = lam.project(z)
        change = z - lam.project(z - rho * gradient(z))
        return np.sqrt(change @ (D * change))  # an energy

    def newton_step(z):
        # the sets (38.12), (38.13): what opens, and what slips
        y = z - rho * gradient(z)
        is_open, slips = lam.normal & (y < 0.0), lam.norms(y) > lam.g
        radial = lam.discs * np.where(slips, y[:, None] / np.maximum(lam.norms(y), lam.g), 0.0)
        # (P M P + diag kappa) s = -P r on this face: slipping nodes move along their circles
        on_face = np.where(is_open | (lam.discs @ slips > 0.0), 0.0, z) + radial @ lam.g
        kappa = lam.discs @ (np.maximum(-radial.T @ gradient(on_face), 0.0) / lam.g)
        P = np.diag(1.0 - is_open) - radial @ radial.T
        system = P @ (M + np.diag(kappa)) @ P + np.eye(len(x)) - P
        return on_face + np.linalg.solve(system, -P @ gradient(on_face)) - z

    best, z, idle = x, x, 0
    # the next product changes the model: a tenth of the first residual is enough
    while residual(best) > 0.1 * residual(x) and idle < 25:
        step, wanted = newton_step(z), 0.9 * residual(z)
        # whole steps; after eight without progress, all but each eighth are divided by four
        is_whole = idle < 8 or (idle + 1) % 8 == 0
        ends = [z + 0.25**n * step for n in range(1 if is_whole else 8)]
        z = next((end for end in ends if residual(end) <= wanted), min(ends, key=residual))
        idle = 0 if residual(z) < 0.9 * residual(best) else idle + 1
        best = min(best, z, key=residual)
    return lam.project(best)


def minimise(A, b, lam, rtol=1e-6):
    """Return the minimiser of q over Lambda."""

    def residual(x, r):  # the natural residual |x - P(x - rho r)| / rho
        return np.linalg.norm(x - lam.project(x - rho * r)) / rho

    model = Model(A, lam.means(np.diag(A)))
    model.product(b)  # for a first rho
    x, r, rho = np.zeros_like(b), -b, model.rho()
    for _ in range(200):
        # Stage 4: stop at a part of the natural residual of x = 0
        if residual(x, r) <= rtol * residual(np.zeros_like(b), -b):
            break
        # Stage 3: one product with A, on the step to the minimum of the model; its part of least q
        d = minimum_of_model(model.matrix(), x, r, lam) - x
        Ad = model.product(d)
        t = np.clip(-(d @ r) / (d @ Ad), 0.0, 1.0) if d @ Ad > 0.0 else 1.0
        x, r = x + t * d, r + t * Ad
        rho = min(rho, model.rho())
    return x
