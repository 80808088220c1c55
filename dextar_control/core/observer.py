"""Platform state by a filter over the Cartesian dynamics: regular on the Type 2 locus, no direct model.

State (x, x_dot, b). Process: x_ddot by ``forward_dynamics`` under the torque that was commanded, which is
regular on the locus; near it the input torques do not act along t_s, so the filter coasts there.
Measurement: q_a = inverse geometric model(x) + b, regular as well; along t_s it says nothing on the locus.
b (2,) is what a wrong geometry adds to the joint angles: without it a tenth of a millimetre is taken for
motion along t_s, amplified by 1/s. Where the weak direction of J_inv does not see x it sees b.

**Crossed or bounced.** Both give the same q_a(t) with the end effector mirrored about the line of the
elbows. After each passage of the locus a second filter starts from the mirror image of the first one's
state and covariance; both predict the joints with their own dynamics, and the log-likelihood ratio of
what is measured (Wald's sequential test) tells which of the two is the robot.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dextar_control.core.compiled import njit
from dextar_control.core.dynamics import forward_dynamics, platform_dynamics
from dextar_control.core.kinematics import (
    direct_geometric_model,
    inverse_geometric_model,
    kinematics,
    singularity,
    state_of_platform,
)
from dextar_control.core.model import Array, Model

STATES = 6
STEP_X, STEP_X_DOT = 1e-6, 1e-5  # m, m/s of the finite differences of x_ddot
MAX_STEP = 1e-3  # s of one prediction; a longer gap is predicted in several
CERTAIN = 20.0  # log-odds at which a belief is kept


class Noise(NamedTuple):
    """Standard deviations that the filter is told; what is "of a sample" is held over one."""

    encoder: float  # of a sample, rad
    bias: float  # of b at the start, rad
    bias_walk: float  # of b's random walk, rad/sqrt(s)
    torque: float  # of a sample: friction and motors, N m
    acceleration: float  # of a sample: masses, m/s^2


class Gauss(NamedTuple):
    """A filter's mean and covariance, changed in place."""

    mean: Array  # (6,) x, x_dot, b
    covariance: Array  # (6, 6)


class Passage(NamedTuple):
    """When the sequential test begins and ends, and what it is told of the noise."""

    armed: float  # |s| within which the assembly mode counts as unknown
    begin: float  # |s| outside which the mirror image can be told from the state
    log_odds: float  # that decide
    noise: Noise  # of the two filters of the test: both fit the joints, so theirs has to be tight


class Bank(NamedTuple):
    """The filters: the one that serves, and the two of the test."""

    main: Gauss
    same: Gauss  # from the main one's state
    image: Gauss  # from its mirror image


MODE, LOG_ODDS, ARMED, TESTING, RATIO, MISFIT_SAME, MISFIT_IMAGE, SAMPLES, SWAPS = range(9)
BELIEF = 9  # numbers of a belief


@njit
def _symmetric(P: Array) -> None:
    for i in range(P.shape[0]):
        for j in range(i):
            mean = 0.5 * (P[i, j] + P[j, i])
            P[i, j] = mean
            P[j, i] = mean


@njit
def begin_at_rest(model: Model, noise: Noise, x: Array, state: Gauss) -> None:
    """A robot at rest at x (2,), known from its joints: what b may be, x may be off by J_inv^-1 b."""
    kin = state_of_platform(model, x, np.zeros(2))
    J = kin.J_inv
    determinant = J[0, 0] * J[1, 1] - J[0, 1] * J[1, 0]
    inverse = np.array([[J[1, 1], -J[0, 1]], [-J[1, 0], J[0, 0]]]) / determinant
    bias, encoder = noise.bias**2, noise.encoder**2
    P = state.covariance
    P[:, :] = 0.0
    P[0:2, 0:2] = (bias + encoder) * (inverse @ inverse.T)
    P[0:2, 4:6] = -bias * inverse
    P[4:6, 0:2] = -bias * inverse.T
    for i in range(2):
        P[2 + i, 2 + i] = 1e-6
        P[4 + i, 4 + i] = bias
    state.mean[:] = 0.0
    state.mean[0:2] = x


@njit
def _acceleration(model: Model, x: Array, x_dot: Array, tau: Array) -> Array:
    return forward_dynamics(model, state_of_platform(model, x, x_dot), tau)


@njit
def predict(model: Model, noise: Noise, state: Gauss, tau: Array, dt: float) -> None:
    """One step of the midpoint rule under tau (2,), N m, and the covariance with it."""
    mean, P = state.mean, state.covariance
    x, x_dot = mean[0:2].copy(), mean[2:4].copy()
    a = _acceleration(model, x, x_dot, tau)
    F = np.eye(STATES)
    for j in range(2):
        shifted = x.copy()
        shifted[j] += STEP_X
        by_x = (_acceleration(model, shifted, x_dot, tau) - a) / STEP_X
        shifted = x_dot.copy()
        shifted[j] += STEP_X_DOT
        by_x_dot = (_acceleration(model, x, shifted, tau) - a) / STEP_X_DOT
        F[j, 2 + j] = dt
        for i in range(2):
            F[i, j] += 0.5 * dt * dt * by_x[i]
            F[2 + i, j] += dt * by_x[i]
            F[2 + i, 2 + j] += dt * by_x_dot[i]
    middle = _acceleration(model, x + 0.5 * dt * x_dot, x_dot + 0.5 * dt * a, tau)
    mean[0:2] += dt * x_dot + 0.5 * dt * dt * a
    mean[2:4] += dt * middle
    kin = state_of_platform(model, x, x_dot)
    mass, _ = platform_dynamics(model, kin)
    determinant = mass[0, 0] * mass[1, 1] - mass[0, 1] * mass[1, 0]
    inverse = np.array([[mass[1, 1], -mass[0, 1]], [-mass[1, 0], mass[0, 0]]]) / determinant
    G = inverse @ kin.J_inv.T  # x_ddot per torque: nothing along t_s on the locus
    P[:, :] = F @ P @ F.T
    for i in range(2):
        for j in range(2):
            shared = noise.torque**2 * (G[i, 0] * G[j, 0] + G[i, 1] * G[j, 1])
            if i == j:
                shared += noise.acceleration**2
            P[2 + i, 2 + j] += dt * dt * shared
        P[4 + i, 4 + i] += dt * noise.bias_walk**2
    _symmetric(P)


@njit
def _update(state: Gauss, H: Array, innovation: Array, variance: float) -> tuple[float, float]:
    """Kalman update with H (2, 6) and equal variances: the innovation's normalised square and ln det of its covariance."""
    P = state.covariance
    PH = P @ H.T
    S = H @ PH
    S[0, 0] += variance
    S[1, 1] += variance
    determinant = S[0, 0] * S[1, 1] - S[0, 1] * S[1, 0]
    inverse = np.array([[S[1, 1], -S[0, 1]], [-S[1, 0], S[0, 0]]]) / determinant
    K = PH @ inverse
    state.mean[:] += K @ innovation
    P[:, :] = P - K @ PH.T
    _symmetric(P)
    return innovation @ (inverse @ innovation), np.log(determinant)


@njit
def correct(model: Model, noise: Noise, state: Gauss, q_meas: Array) -> tuple[float, float]:
    """Take the active joints (2,), rad, on any turn; see ``_update`` for what is returned."""
    x = state.mean[0:2].copy()
    kin = state_of_platform(model, x, np.zeros(2))
    H = np.zeros((2, STATES))
    H[:, 0:2] = kin.J_inv
    innovation = np.empty(2)
    for i in range(2):
        H[i, 4 + i] = 1.0
        angle = q_meas[i] - kin.q_a[i] - state.mean[4 + i]
        innovation[i] = angle - 2.0 * np.pi * np.floor((angle + np.pi) / (2.0 * np.pi))
    return _update(state, H, innovation, noise.encoder**2)


@njit
def correct_position(state: Gauss, x_meas: Array, deviation: float) -> tuple[float, float]:
    """Take an external position (2,), m, with its standard deviation, m; see ``_update`` for what is returned."""
    H = np.zeros((2, STATES))
    H[0, 0] = 1.0
    H[1, 1] = 1.0
    return _update(state, H, x_meas - state.mean[0:2], deviation**2)


@njit
def mirror(model: Model, state: Gauss, image: Gauss) -> bool:
    """The same joint angles and velocities in the other assembly mode, with its covariance; false where undefined."""
    x, x_dot = state.mean[0:2].copy(), state.mean[2:4].copy()
    kin = state_of_platform(model, x, x_dot)
    mode = 1.0 if singularity(model, kin.A_r) > 0.0 else -1.0
    other = direct_geometric_model(model, kin.q_a, -mode)
    J = kinematics(model, kin.q_a, other, np.zeros(2)).J_inv
    determinant = J[0, 0] * J[1, 1] - J[0, 1] * J[1, 0]
    inverse = np.array([[J[1, 1], -J[0, 1]], [-J[1, 0], J[0, 0]]]) / determinant
    T = np.zeros((STATES, STATES))
    T[0:2, 0:2] = inverse @ kin.J_inv
    T[2:4, 2:4] = T[0:2, 0:2]
    T[4, 4] = 1.0
    T[5, 5] = 1.0
    image.mean[0:2] = other
    image.mean[2:4] = inverse @ kin.q_a_dot
    image.mean[4:6] = state.mean[4:6]
    image.covariance[:, :] = T @ state.covariance @ T.T
    same = inverse_geometric_model(model, other)
    near = abs(same[0] - kin.q_a[0]) + abs(same[1] - kin.q_a[1]) < 1e-6  # still in this working mode
    return bool(near and np.isfinite(image.mean).all())


@njit
def _measure(model: Model, state: Gauss) -> tuple[float, bool]:
    """s, and whether the distal links are nearer to stretched than to folded."""
    kin = state_of_platform(model, state.mean[0:2].copy(), np.zeros(2))
    s = singularity(model, kin.A_r)
    return s, kin.A_r[0, 0] * kin.A_r[1, 0] + kin.A_r[0, 1] * kin.A_r[1, 1] < 0.0


@njit
def observe(
    model: Model, noise: Noise, passage: Passage, bank: Bank, belief: Array, tau: Array, dt: float, q_meas: Array
) -> None:
    """One sample: the filters and the belief about the assembly mode, all changed in place.

    Args:
        belief: (BELIEF,) assembly mode; log-odds of it; armed; testing; log-likelihood ratio of the two filters of the
            test; sum of each one's squared normalised innovations; samples; how often the image was the robot.
        tau: (2,) commanded since the last sample, N m.
        dt: since the last sample, s.
        q_meas: (2,) rad.
    """
    testing = belief[TESTING] > 0.0
    steps = int(np.ceil(dt / MAX_STEP - 1e-6))
    for _ in range(steps):
        predict(model, noise, bank.main, tau, dt / steps)
        if testing:
            predict(model, passage.noise, bank.same, tau, dt / steps)
            predict(model, passage.noise, bank.image, tau, dt / steps)
    correct(model, noise, bank.main, q_meas)
    if testing:
        same, spread_same = correct(model, passage.noise, bank.same, q_meas)
        image, spread_image = correct(model, passage.noise, bank.image, q_meas)
        if np.isfinite(same + image):
            weigh(belief, same, spread_same, image, spread_image)
    judge_passage(model, passage, bank, belief)


@njit
def weigh(belief: Array, same: float, spread_same: float, image: float, spread_image: float) -> None:
    """Take one measurement's two likelihoods into the belief.

    Where even the better filter fits worse than the noise that it was told, the log-odds shrink by that factor:
    a wrong model makes the test unsure, not wrong.
    """
    belief[RATIO] += 0.5 * (image + spread_image - same - spread_same)
    belief[MISFIT_SAME] += same
    belief[MISFIT_IMAGE] += image
    belief[SAMPLES] += 1.0
    misfit = min(belief[MISFIT_SAME], belief[MISFIT_IMAGE]) / (2.0 * belief[SAMPLES])
    belief[LOG_ODDS] = belief[RATIO] / max(1.0, misfit)


@njit
def judge_passage(model: Model, passage: Passage, bank: Bank, belief: Array) -> None:
    """Begin, go on with or end the test of crossed against bounced; see ``observe``."""
    main = bank.main
    s, stretched = _measure(model, main)
    mode = 1.0 if s > 0.0 else -1.0
    if abs(s) < passage.armed:
        belief[ARMED:SWAPS] = 0.0
        belief[ARMED] = 1.0
        belief[LOG_ODDS] = 0.0
    elif belief[ARMED] > 0.0 and abs(s) >= passage.begin:
        belief[ARMED] = 0.0
        if not stretched:
            belief[LOG_ODDS] = CERTAIN  # folded: the image is a whole turn away, the joints tell
        elif mirror(model, main, bank.image):
            bank.same.mean[:] = main.mean
            bank.same.covariance[:, :] = main.covariance
            belief[TESTING] = 1.0
    elif belief[TESTING] > 0.0 and abs(belief[LOG_ODDS]) >= passage.log_odds:
        if belief[LOG_ODDS] < 0.0:
            main.mean[:] = bank.image.mean
            main.covariance[:, :] = bank.image.covariance
            mode = -mode
            belief[SWAPS] += 1.0
        belief[TESTING] = 0.0
        belief[LOG_ODDS] = CERTAIN
    belief[MODE] = mode
