"""QUEST: the attitude that fits two or more measured directions best.

Shuster and Oh, "Three-axis attitude determination from vector observations", Journal of Guidance
and Control 4(1), 1981. Equation numbers here are those of that paper.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["quest"]

Array = NDArray[np.float64]

#: Turns of the reference frame by half a turn: none, then about x, y and z (its section on
#: sequential rotations). Signs of the reference components, shape (4, 3).
TURNS = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])
#: Quaternion of each turn, rows.
TURN_QUATERNIONS = np.array(
    [[0.0, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]
)
NEWTON_STEPS = 20


def _adjugate_trace(S: Array) -> Array:
    """Trace of the adjugate of symmetric matrices (..., 3, 3), kappa (equation 63)."""
    trace = np.trace(S, axis1=-2, axis2=-1)
    return 0.5 * (trace * trace - np.einsum("...ij,...ji->...", S, S))


def _largest_eigenvalue(S: Array, Z: Array, sigma: Array, start: float) -> Array:
    """Largest root of the characteristic equation, by Newton's method (equations 69 to 71)."""
    SZ = np.einsum("...ij,...j->...i", S, Z)
    kappa, delta = _adjugate_trace(S), np.linalg.det(S)
    a = sigma * sigma - kappa
    b = sigma * sigma + np.sum(Z * Z, axis=-1)
    c = delta + np.sum(Z * SZ, axis=-1)
    d = np.sum(SZ * SZ, axis=-1)
    root = np.full(sigma.shape, start)
    for _ in range(NEWTON_STEPS):
        square = root * root
        value = (square - a) * (square - b) - c * root + c * sigma - d
        slope = 2.0 * root * (2.0 * square - a - b) - c
        # The root is the largest and the start above it, so the slope there is positive; rounding
        # may spoil that where two roots meet.
        change = np.divide(value, slope, out=np.zeros_like(value), where=slope > 0.0)
        root = root - change
        if np.abs(change).max(initial=0.0) <= 1e-16 * start:
            break
    return root


def quest(measured: ArrayLike, references: ArrayLike, weights: ArrayLike | None = None) -> Array:
    """Find the attitude that minimises Wahba's loss (QUEST).

    Parameters
    ----------
    measured
        Directions in the body frame, shape (..., k, 3), k at least 2; their lengths do not matter.
    references
        The same directions in the inertial frame, of a shape that broadcasts.
    weights
        Weight of each direction, shape (k,), positive, such as 1 / sigma^2; None is equal ones.

    Returns
    -------
    array of shape (..., 4)
        Unit quaternions (scalar last, inertial to body) with ``attitude_matrix(q) @ reference``
        close to measured.

    Raises
    ------
    ValueError
        If there are fewer than two directions, a direction is zero or not finite, a weight is not
        positive, or all directions of a sample are parallel, so that the attitude about them is
        not observable.
    """
    b, r = np.broadcast_arrays(
        np.asarray(measured, dtype=np.float64), np.asarray(references, dtype=np.float64)
    )
    if b.ndim < 2 or b.shape[-1] != 3 or b.shape[-2] < 2:
        raise ValueError(f"Directions must have the shape (..., 2 or more, 3), not {b.shape!r}")
    given = np.ones(b.shape[-2]) if weights is None else np.asarray(weights, dtype=np.float64)
    if given.shape != b.shape[-2:-1]:
        raise ValueError(f"weights must have the shape {b.shape[-2:-1]}, not {given.shape!r}")
    if not ((given > 0.0) & np.isfinite(given)).all():
        raise ValueError(f"weights must be finite and more than 0, not {given.tolist()!r}")
    a = given / given.sum()
    units: list[Array] = []
    for name, vectors in (("measured", b), ("references", r)):
        lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
        if not ((lengths > 0.0) & np.isfinite(lengths)).all():
            raise ValueError(f"{name} must be finite and not zero, not {vectors.tolist()!r}")
        unit = vectors / lengths
        # Directions that are all parallel make a matrix of rank one.
        second = np.linalg.svd(unit, compute_uv=False)[..., 1]
        if not (second > 1e-8).all():
            raise ValueError(f"{name} must not be parallel, not {vectors.tolist()!r}")
        units.append(unit)
    body, reference = units

    B = np.einsum("k,...ki,...kj->...ij", a, body, reference)
    turned = B[..., None, :, :] * TURNS[:, None, :]  # (..., 4, 3, 3): one for each turn
    S = turned + np.swapaxes(turned, -1, -2)
    sigma = np.trace(turned, axis1=-2, axis2=-1)
    Z = np.stack(
        [turned[..., 1, 2] - turned[..., 2, 1], turned[..., 2, 0] - turned[..., 0, 2],
         turned[..., 0, 1] - turned[..., 1, 0]], axis=-1,
    )  # fmt: skip
    # Turning the reference frame does not change the eigenvalue.
    root = _largest_eigenvalue(S[..., 0, :, :], Z[..., 0, :], sigma[..., 0], 1.0)[..., None]
    alpha = root * root - sigma * sigma + _adjugate_trace(S)  # equation 66
    beta = root - sigma
    gamma = (root + sigma) * alpha - np.linalg.det(S)
    SZ = np.einsum("...ij,...j->...i", S, Z)
    SSZ = np.einsum("...ij,...j->...i", S, SZ)
    X = alpha[..., None] * Z + beta[..., None] * SZ + SSZ  # equation 68
    # gamma vanishes where the attitude is half a turn away: the turn with the largest is safest.
    q = np.concatenate((X, gamma[..., None]), axis=-1)
    best = np.argmax(np.abs(gamma), axis=-1)[..., None, None]
    chosen = np.take_along_axis(q, best, axis=-2)[..., 0, :]
    chosen = chosen / np.linalg.norm(chosen, axis=-1, keepdims=True)
    return np.asarray(_undo(chosen, TURN_QUATERNIONS[best[..., 0, 0]]), dtype=np.float64)


def _undo(q: Array, turn: Array) -> Array:
    """Quaternion of A(q) A(turn), both (..., 4): undoes a turn of the reference frame."""
    v, s = q[..., :3], q[..., 3:]
    w, c = turn[..., :3], turn[..., 3:]
    vector = s * w + c * v + np.cross(w, v)
    return np.concatenate((vector, s * c - np.sum(v * w, axis=-1, keepdims=True)), axis=-1)
