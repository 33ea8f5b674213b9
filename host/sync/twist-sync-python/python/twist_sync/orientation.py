"""Orientations turned into rates: quaternions, rotation matrices, Euler angles.

An orientation turns vectors of the body into those of the room. From one to the next the body
turns by ``conj(q0) q1``, in its own axes; divided by the time between them that is the mean rate
of the interval, of its middle. The noise of an orientation is divided by that time too.
"""

from __future__ import annotations

import numpy as np

#: Share of orientations whose size is that of one, at least, and by how much it may be off.
MOST, SIZE = 0.98, 0.02
#: A body turns less from one orientation to the next, rad.
LARGEST_TURN = 0.8


def multiplied(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Returns the products of quaternions w, x, y, z, shape (n, 4)."""
    a, u, b, v = p[:, :1], p[:, 1:], q[:, :1], q[:, 1:]
    return np.hstack([a * b - (u * v).sum(axis=1, keepdims=True), a * v + b * u + np.cross(u, v)])


def is_quaternion(q: np.ndarray) -> bool:
    """Returns True for quaternions of length one that are not all the same; zeros are none."""
    q = q[np.isfinite(q).all(axis=1) & q.any(axis=1)]
    fits = np.abs(np.linalg.norm(q, axis=1) - 1) < SIZE
    return len(q) > 1 and bool(fits.mean() > MOST and np.ptp(q, axis=0).any())


def is_matrix(m: np.ndarray) -> bool:
    """Returns True for rotation matrices, row by row, shape (n, 9), that are not all the same."""
    m = m[np.isfinite(m).all(axis=1)].reshape(-1, 3, 3)
    if len(m) < 2 or not np.ptp(m, axis=0).any():
        return False
    off = np.abs(m @ m.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    return bool(((off < SIZE) & (np.linalg.det(m) > 0)).mean() > MOST)


def of_matrix(m: np.ndarray) -> np.ndarray:
    """Returns the quaternions of rotation matrices, shape (n, 9): of the matrix of their products,
    4 q qᵀ, the row of the largest component, <https://doi.org/10.2514/3.55767b>."""
    m = m.reshape(-1, 3, 3)
    trace = np.trace(m, axis1=1, axis2=2)[:, None, None]
    turn = m - m.transpose(0, 2, 1)
    first = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1)[:, None]
    rest = m + m.transpose(0, 2, 1) + (1 - trace) * np.eye(3)
    forms = np.block([[1 + trace, first], [first.transpose(0, 2, 1), rest]])
    q = forms[np.arange(len(m)), np.argmax(np.diagonal(forms, axis1=1, axis2=2), axis=1)]
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def of_angles(angles: np.ndarray, order: str) -> np.ndarray:
    """Returns the quaternions of angles about x, y, z, rad, shape (n, 3), about the axes that turn
    along, in an order such as "ZYX"."""
    out = np.tile([1.0, 0, 0, 0], (len(angles), 1))
    for axis in order:
        k = "XYZ".index(axis)
        q = np.zeros((len(angles), 4))
        q[:, 0], q[:, k + 1] = np.cos(angles[:, k] / 2), np.sin(angles[:, k] / 2)
        out = multiplied(out, q)
    return out


def rates(t: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Returns times, ns, and rates, rad/s, midway between orientations at times t, ns, and what
    was left out: turns over gaps, over values that were held, and flips."""
    q = q / np.linalg.norm(q, axis=1, keepdims=True)
    step = float(np.median(np.diff(t)))
    turn, sine = _turns(q)
    angle = np.linalg.norm(turn, axis=1)
    # A value that is held and then made up for: the body turns before and after.
    moving = float(np.median(angle))
    is_held = (sine == 0) & (moving > 0)
    near = np.convolve(angle > 0.3 * moving, np.ones(5), "same") >= 2
    held = np.flatnonzero(is_held & near) + 1
    notes = []
    if 0 < len(held) < len(q) // 2:
        notes.append(f"{len(held)} orientations repeat the one before: left out")
        keep = np.ones(len(q), bool)
        keep[held] = False
        t, q = t[keep], q[keep]
        turn, _ = _turns(q)
        angle = np.linalg.norm(turn, axis=1)
    apart = np.diff(t)
    gap = (apart <= 0) | (apart > 2.5 * step)
    # A jump that its neighbours do not have: another labelling of markers, a loop closure.
    around = np.maximum(np.r_[0, angle[:-1]], np.r_[angle[1:], 0])
    flip = ~gap & ((angle > LARGEST_TURN) | ((angle > 0.1) & (angle > 8 * around + 4 * moving)))
    if gap.any():
        notes.append(f"{gap.sum()} gaps of its orientations are left out")
    if flip.any():
        notes.append(f"{flip.sum()} jumps of its orientation are left out")
    good = ~gap & ~flip
    middle = t[:-1] + apart // 2
    return middle[good], turn[good] / (apart[good, None] * 1e-9), notes


def _turns(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the turn from each orientation to the next as a vector, rad, and the sine of its
    half."""
    d = multiplied(q[:-1] * [1, -1, -1, -1], q[1:])
    # An orientation and its negative are the same.
    d = np.where(d[:, :1] < 0, -d, d)
    sine = np.linalg.norm(d[:, 1:], axis=1)
    angle = 2 * np.arctan2(sine, d[:, 0])
    return d[:, 1:] * (angle / np.where(sine > 0, sine, 1))[:, None], sine
