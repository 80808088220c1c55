"""Singular vectors of a matrix that may lose one rank in each of its blocks, on
symbols: continuous through the singularity.

A = sum of sigma_i u_i v_i^T. The strong pairs come from A itself; the weak one is what
is orthogonal to them, so that it exists on the locus too, and its singular value is
signed: det(A) over the others. Nothing jumps or changes sign there.

Rows and columns that no entry couples are blocks, k in number, mostly one: each has
strong pairs and a weak one of its own, and A may lose k ranks at once.
"""

from __future__ import annotations

from functools import reduce
from operator import mul
from typing import NamedTuple

import casadi as ca

from dextar_control.symbols.types import Symbol

SWEEPS = 5  # of Jacobi's rotations: they converge quadratically


class Block(NamedTuple):
    """Entries of a matrix that share no row and no column with an entry elsewhere that
    may differ from zero.
    """

    rows: list[int]
    columns: list[int]


class SingularVectors(NamedTuple):
    """A = U_strong diag(sigma_strong) V_strong^T + U_weak diag(sigma_weak) V_weak^T.

    Attributes:
        u_strong, v_strong: (n, n - k), in columns.
        sigma_strong: (n - k,), > 0.
        u_weak, v_weak: (n, k), a column a block.
        sigma_weak: (k,), each with the sign of its block's determinant.
    """

    u_strong: Symbol
    sigma_strong: Symbol
    v_strong: Symbol
    u_weak: Symbol
    sigma_weak: Symbol
    v_weak: Symbol


def blocks(A: Symbol) -> list[Block]:
    """Return the blocks of a square matrix by its sparsity, in the order of their
    columns.
    """
    n, pattern = A.shape[0], A.sparsity()
    empty = ca.Sparsity(n, n)
    # rows and columns are the nodes of a graph, entries its edges
    graph = ca.vertcat(ca.horzcat(empty, pattern), ca.horzcat(pattern.T, empty))
    count, order, begins = graph.scc()
    parts = [sorted(order[begins[i] : begins[i + 1]]) for i in range(count)]
    found = [
        Block([i for i in part if i < n], [i - n for i in part if i >= n])
        for part in parts
    ]
    return sorted(found, key=lambda block: block.columns)


def nearest(s: Symbol, values: Symbol) -> Symbol:
    """Return that of values (k,), one a block, that of the block whose s (k,) is least
    in size.
    """
    least, value = s[0], values[0]
    for i in range(1, s.shape[0]):
        nearer = ca.fabs(s[i]) < ca.fabs(least)
        least, value = (
            ca.if_else(nearer, s[i], least),
            ca.if_else(nearer, values[i], value),
        )
    return value


def singular_vectors(A: Symbol) -> SingularVectors:
    """Return the singular vectors of a square matrix (n, n); v_weak is oriented as the
    cofactors of its block's last row.
    """
    parts = blocks(A)
    if len(parts) == 1:
        return _of_block(A)
    found = [_of_block(A[rows, columns]) for rows, columns in parts]

    def placed(name: str, side: str) -> Symbol:
        """Return the vectors of all blocks, among the rows (u) or columns (v) of A."""
        every = []
        for part, one in zip(parts, found, strict=True):
            vectors = ca.SX(A.shape[0], getattr(one, name).shape[1])
            vectors[getattr(part, side), :] = getattr(one, name)
            every.append(vectors)
        return ca.horzcat(*every)

    strong, weak = (
        ca.vertcat(*(getattr(one, name) for one in found))
        for name in ("sigma_strong", "sigma_weak")
    )
    return SingularVectors(
        placed("u_strong", "rows"),
        strong,
        placed("v_strong", "columns"),
        placed("u_weak", "rows"),
        weak,
        placed("v_weak", "columns"),
    )


def _of_block(A: Symbol) -> SingularVectors:
    """Return the singular vectors of a matrix that is one block."""
    n = A.shape[0]
    if n == 1:
        return SingularVectors(
            ca.SX(1, 0), ca.SX(0, 1), ca.SX(1, 0), ca.SX(1.0), A, ca.SX(1.0)
        )
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
    sigma_weak = ca.det(A) / reduce(mul, ca.vertsplit(sigma_strong))
    return SingularVectors(u_strong, sigma_strong, v_strong, u_weak, sigma_weak, v_weak)


def orthogonal(columns: Symbol) -> Symbol:
    """Return the unit vector (n,) orthogonal to n - 1 orthogonal unit columns (n, n -
    1), so that all n are a rotation: the cross product for n = 3.
    """
    n = columns.shape[0]
    cofactors = []
    for row in range(n):
        rest = ca.vertcat(columns[:row, :], columns[row + 1 :, :])
        cofactors.append((-1.0) ** (row + n - 1) * ca.det(rest))
    return ca.vertcat(*cofactors)


def _strong_right(A: Symbol) -> Symbol:
    """Return the right singular vectors (n, n - 1) but the weakest."""
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
    order = [(gram[i, i], V[:, i]) for i in range(n)]
    for place in range(n - 1):  # the smallest moves to the end
        (first, v_first), (second, v_second) = order[place], order[place + 1]
        smaller = first < second
        order[place] = (
            ca.if_else(smaller, second, first),
            ca.if_else(smaller, v_second, v_first),
        )
        order[place + 1] = (
            ca.if_else(smaller, first, second),
            ca.if_else(smaller, v_first, v_second),
        )
    return ca.horzcat(*(vector for _, vector in order[: n - 1]))
