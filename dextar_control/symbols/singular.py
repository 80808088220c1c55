"""Singular vectors of a matrix that may lose one rank, on symbols: continuous through the singularity.

A = sum of sigma_i u_i v_i^T. The strong pairs come from A itself; the weak one is what is orthogonal to them, so that it exists
on the locus too, and its singular value is signed: det(A) over the others. Nothing jumps or changes sign there.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

from dextar_control.symbols.types import Symbol

SWEEPS = 5  # of Jacobi's rotations: they converge quadratically


class SingularVectors(NamedTuple):
    """A = U_strong diag(sigma_strong) V_strong^T + sigma_weak u_weak v_weak^T.

    Attributes:
        u_strong, v_strong: (n, n - 1), in columns.
        sigma_strong: (n - 1,), > 0.
        u_weak, v_weak: (n,).
        sigma_weak: with the sign of det(A).
    """

    u_strong: Symbol
    sigma_strong: Symbol
    v_strong: Symbol
    u_weak: Symbol
    sigma_weak: Symbol
    v_weak: Symbol


def singular_vectors(A: Symbol) -> SingularVectors:
    """Of a square matrix (n, n), n >= 2; v_weak is oriented as the cofactors of A's last row."""
    n = A.shape[0]
    v_strong = _strong_right(A)
    columns = A @ v_strong
    sigma_strong = ca.vertcat(*(ca.norm_2(columns[:, i]) for i in range(n - 1)))
    v_weak = orthogonal(v_strong)
    orientation = ca.sign(ca.dot(v_weak, orthogonal(A[: n - 1, :].T)))
    flip = ca.if_else(orientation < 0.0, -1.0, 1.0)
    v_weak = flip * v_weak
    v_strong = ca.horzcat(flip * v_strong[:, 0], v_strong[:, 1:])
    columns = ca.horzcat(flip * columns[:, 0], columns[:, 1:])
    u_strong = columns @ ca.diag(1.0 / sigma_strong)
    u_weak = orthogonal(u_strong)
    sigma_weak = ca.det(A) / _product(sigma_strong)
    return SingularVectors(u_strong, sigma_strong, v_strong, u_weak, sigma_weak, v_weak)


def orthogonal(columns: Symbol) -> Symbol:
    """Unit vector (n,) orthogonal to n - 1 orthogonal unit columns, so that all n are a rotation; the cross product for n = 3."""
    n = columns.shape[0]
    cofactors = []
    for row in range(n):
        rest = ca.vertcat(columns[:row, :], columns[row + 1 :, :])
        cofactors.append((-1.0) ** (row + n - 1) * ca.det(rest))
    return ca.vertcat(*cofactors)


def _product(vector: Symbol) -> Symbol:
    result = vector[0]
    for i in range(1, vector.shape[0]):
        result *= vector[i]
    return result


def _strong_right(A: Symbol) -> Symbol:
    """(n, n - 1) right singular vectors but the weakest's."""
    n = A.shape[0]
    gram, V = A.T @ A, ca.SX.eye(n)
    for _ in range(1 if n == 2 else SWEEPS):
        for i in range(n - 1):
            for j in range(i + 1, n):
                angle = 0.5 * ca.atan2(2.0 * gram[i, j], gram[i, i] - gram[j, j])
                rotation = ca.SX.eye(n)
                rotation[i, i] = rotation[j, j] = ca.cos(angle)
                rotation[i, j], rotation[j, i] = -ca.sin(angle), ca.sin(angle)
                gram, V = rotation.T @ gram @ rotation, V @ rotation
    # each rotation leaves the larger of its two diagonal entries first, so the weakest may stand last but for its order:
    order = [(gram[i, i], V[:, i]) for i in range(n)]
    for place in range(n - 1):  # the smallest moves to the end
        (first, v_first), (second, v_second) = order[place], order[place + 1]
        smaller = first < second
        order[place] = ca.if_else(smaller, second, first), ca.if_else(smaller, v_second, v_first)
        order[place + 1] = ca.if_else(smaller, first, second), ca.if_else(smaller, v_first, v_second)
    return ca.horzcat(*(vector for _, vector in order[: n - 1]))
