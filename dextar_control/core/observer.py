"""Platform state by a filter over the Cartesian dynamics: regular on the Type 2 locus, no direct model.

State (x, x_dot, b). Process: x_ddot by ``forward_dynamics`` under the torque that was commanded, which is
regular on the locus; near it the input torques do not act along t_s, so the filter coasts there.
Measurement: q_a = inverse geometric model(x) + b, regular as well; along t_s it says nothing on the locus.
b (2,) is what a wrong geometry adds to the joint angles: without it a tenth of a millimetre is taken for
motion along t_s, amplified by 1/s. Where the weak direction of J_inv does not see x it sees b.

**Crossed or bounced.** Both give the same q_a(t) with the end effector mirrored about the line of the
elbows. After each passage of the locus a second filter starts from the mirror image of the first one's
state and covariance; both predict the joints with their own dynamics, and the log-likelihood ratio of
what is measured (Wald's sequential test) tells which of the two is the robot. The same test begins where
the joints suddenly fit the believed motion no longer.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dextar_control.core.compiled import njit
from dextar_control.core.dynamics import apply, friction, inverse, platform_dynamics
from dextar_control.core.kinematics import (
    direct_geometric_model,
    inverse_geometric_model,
    kinematics,
    singularity,
    state_of_platform,
    type1_distance,
)
from dextar_control.core.law import smooth_step
from dextar_control.core.model import Array, Model

STATES = 6
STEP = 1e-6  # m of the finite differences of s
REST_SPEED = 1e-3  # m/s, standard deviation of a robot at rest
MAX_STEP = 1e-3  # s of one prediction; a longer gap is predicted in several
LONG = 0.1  # s of a gap over which nothing is predicted any more
CERTAIN = 20.0  # log-odds at which a belief is kept
CORRELATED = 10.0  # samples over which the innovations of a wrong model hang together: so many count as one
DOUBT, DOUBT_TIME = 20.0, 5e-3  # misfit over the known one, averaged over so many s, that begins a test ...
DOUBT_S = 0.4  # ... where |s| is below this: farther from the locus it is somebody's push, not the other side
RISE, FORGET = 0.05, 5.0  # s over which the misfit in a known assembly mode is averaged, up and down: a model stays wrong
LOST = 0.5  # of the least distance to Type 1, below which the working mode is no longer sure
CONTRAST = 3.0, 6.0  # how many times worse the less likely filter has to fit before the test begins to count, and fully does


class Noise(NamedTuple):
    """Standard deviations that the filter is told; what is "of a sample" is held over one."""

    encoder: float  # of a sample, rad
    bias: float  # of b at the start, rad
    bias_walk: float  # of b's random walk as the joints move, rad/sqrt(rad)
    torque: float  # of a sample: friction and motors, N m
    acceleration: float  # of a sample: masses, m/s^2
    shock_gate: float  # squared normalised innovation that only a blow explains
    shock_speed: float  # of x_dot after a blow, m/s


class Gauss(NamedTuple):
    """A filter's mean and covariance, changed in place."""

    mean: Array  # (6,) x, x_dot, b
    covariance: Array  # (6, 6)
    x_ddot: Array  # (2,) of the last prediction


class Passage(NamedTuple):
    """When the sequential test begins and ends, and what it is told of the noise."""

    armed: float  # |s| within which the assembly mode counts as unknown
    begin: float  # |s| outside which the mirror image can be told from the state
    log_odds: float  # that decide
    noise: Noise  # of the two filters of the test: both fit the joints, so theirs has to be tight


class Bank(NamedTuple):
    """The filters: the one that serves, and the two of the test."""

    main: Gauss
    same: Gauss  # from the main one's state; while there is no test it tells how well the model fits
    image: Gauss  # from its mirror image


FILTER = STATES + 2 + STATES * STATES  # numbers of a filter
TUNING = 2 * len(Noise._fields) + 3  # numbers of a tuning


@njit
def unpack_filter(numbers: Array) -> Gauss:
    """A filter in a vector (FILTER,); its arrays are views."""
    return Gauss(numbers[0:STATES], numbers[STATES + 2 :].reshape(STATES, STATES), numbers[STATES : STATES + 2])


@njit
def unpack_bank(filters: Array) -> Bank:
    """The filters in an array (3, FILTER); their arrays are views."""
    return Bank(unpack_filter(filters[0]), unpack_filter(filters[1]), unpack_filter(filters[2]))


@njit
def unpack_tuning(v: Array) -> tuple[Noise, Passage]:
    """The noise and the passage of a packed vector (TUNING,); see ``pack_tuning``."""
    noise = Noise(v[0], v[1], v[2], v[3], v[4], v[5], v[6])
    return noise, Passage(v[14], v[15], v[16], Noise(v[7], v[8], v[9], v[10], v[11], v[12], v[13]))


def pack_tuning(noise: Noise, passage: Passage) -> Array:
    """One vector (TUNING,) of both."""
    return np.array([*noise, *passage.noise, passage.armed, passage.begin, passage.log_odds])


MODE, LOG_ODDS, ARMED, TESTING, RATIO, MISFIT_SAME, MISFIT_IMAGE, SAMPLES, SWAPS = range(9)
MISFIT_KNOWN, MISFIT_NOW, DOUBTFUL, SEEN, STRAYED = range(9, 14)
BELIEF = 14  # numbers of a belief


@njit
def begin(model: Model, noise: Noise, x: Array, speed: float, state: Gauss) -> None:
    """A robot at x (2,), known from its joints: what b may be, x may be off by J_inv^-1 b.

    Args:
        speed: standard deviation of its velocity about zero, m/s.
    """
    J = inverse(state_of_platform(model, x, np.zeros(2)).J_inv)
    bias, encoder = noise.bias**2, noise.encoder**2
    P = state.covariance
    P[:, :] = 0.0
    P[0:2, 0:2] = (bias + encoder) * (J @ J.T)
    P[0:2, 4:6] = -bias * J
    P[4:6, 0:2] = -bias * J.T
    for i in range(2):
        P[2 + i, 2 + i] = speed**2
        P[4 + i, 4 + i] = bias
    state.mean[:] = 0.0
    state.mean[0:2] = x
    state.x_ddot[:] = 0.0


@njit
def begin_again(model: Model, noise: Noise, bank: Bank, belief: Array, q_meas: Array) -> None:
    """The joints q_meas (2,) are all that is known: they are taken in the assembly mode believed so far, unsure of it."""
    x = direct_geometric_model(model, q_meas, belief[MODE] if belief[MODE] != 0.0 else 1.0)
    begin(model, noise, x, noise.shock_speed, bank.main)
    copy(bank.main, bank.same)
    belief[LOG_ODDS:SWAPS] = 0.0
    belief[SEEN] = 0.0


@njit
def predict(model: Model, noise: Noise, state: Gauss, tau: Array, dt: float) -> None:
    """One step under tau (2,), N m: x_ddot by the forward dynamics in its middle, and the covariance with it.

    b changes with the configuration: it walks as the joints move and stands still with them. A walk in time would let a
    robot that is held drift away, for at rest the joints cannot tell x from b. The covariance takes x_ddot for
    independent of the state, which over a sample it nearly is. The torque's noise acts through M^-1 J_inv^T: not along
    t_s on the locus.
    """
    mean, P = state.mean, state.covariance
    x, x_dot = mean[0:2].copy(), mean[2:4].copy()
    kin = state_of_platform(model, x + 0.5 * dt * x_dot, x_dot + 0.5 * dt * state.x_ddot)
    mass, bias = platform_dynamics(model, kin)
    M, J = inverse(mass), kin.J_inv
    state.x_ddot[:] = apply(M, apply(J.T, tau - friction(model, kin.q_a_dot)) - bias)
    G = np.zeros((2, 2))  # x_ddot per torque
    for i in range(2):
        for leg in range(2):
            G[i, leg] = M[i, 0] * J[leg, 0] + M[i, 1] * J[leg, 1]
    for i in range(2):
        mean[i] += dt * (x_dot[i] + 0.5 * dt * state.x_ddot[i])
        mean[2 + i] += dt * state.x_ddot[i]
    for i in range(2):  # F P, then (F P) F^T, with F = [[1, dt, 0], [0, 1, 0], [0, 0, 1]]
        for j in range(STATES):
            P[i, j] += dt * P[2 + i, j]
    for i in range(2):
        for j in range(STATES):
            P[j, i] += dt * P[j, 2 + i]
    for i in range(2):
        for j in range(2):
            P[2 + i, 2 + j] += (dt * noise.torque) ** 2 * (G[i, 0] * G[j, 0] + G[i, 1] * G[j, 1])
        P[2 + i, 2 + i] += (dt * noise.acceleration) ** 2
        P[4 + i, 4 + i] += dt * abs(kin.q_a_dot[i]) * noise.bias_walk**2


@njit
def allow_for_shock(noise: Noise, state: Gauss, dt: float) -> None:
    """A blow somewhere in the last dt: x_dot is anything up to shock_speed off, and x what came of it."""
    variance = noise.shock_speed**2
    P = state.covariance
    for i in range(2):
        P[i, i] += variance * dt * dt
        P[i, 2 + i] += variance * dt
        P[2 + i, i] += variance * dt
        P[2 + i, 2 + i] += variance


@njit
def _seen(P: Array, J: Array, bias: float, variance: float) -> tuple[Array, Array]:
    """P H^T (6, 2) and H P H^T + variance 1 (2, 2), with H = [J, 0, bias 1]."""
    PH = np.empty((STATES, 2))
    S = np.empty((2, 2))
    for row in range(2):
        for i in range(STATES):
            PH[i, row] = P[i, 0] * J[row, 0] + P[i, 1] * J[row, 1] + bias * P[i, 4 + row]
    for row in range(2):
        for column in range(2):
            S[row, column] = J[row, 0] * PH[0, column] + J[row, 1] * PH[1, column] + bias * PH[4 + row, column]
        S[row, row] += variance
    return PH, S


@njit
def _update(state: Gauss, PH: Array, S: Array, innovation: Array) -> tuple[float, float]:
    """Kalman update: the innovation's normalised square and ln det of its covariance S."""
    P = state.covariance
    S_inverse = inverse(S)
    weighted = apply(S_inverse, innovation)
    for i in range(STATES):
        state.mean[i] += PH[i, 0] * weighted[0] + PH[i, 1] * weighted[1]
        left = PH[i, 0] * S_inverse[0, 0] + PH[i, 1] * S_inverse[1, 0]
        right = PH[i, 0] * S_inverse[0, 1] + PH[i, 1] * S_inverse[1, 1]
        for j in range(i + 1):
            P[i, j] -= left * PH[j, 0] + right * PH[j, 1]
            P[j, i] = P[i, j]
    square = innovation[0] * weighted[0] + innovation[1] * weighted[1]
    return square, np.log(S[0, 0] * S[1, 1] - S[0, 1] * S[1, 0])


@njit
def _innovation(model: Model, state: Gauss, q_meas: Array) -> tuple[Array, Array]:
    """J_inv (2, 2) and the innovation (2,), rad, of the active joints (2,) on any turn."""
    kin = state_of_platform(model, state.mean[0:2], np.zeros(2))
    innovation = np.empty(2)
    for i in range(2):
        angle = q_meas[i] - kin.q_a[i] - state.mean[4 + i]
        innovation[i] = angle - 2.0 * np.pi * np.floor((angle + np.pi) / (2.0 * np.pi))
    return kin.J_inv, innovation


@njit
def innovate(model: Model, noise: Noise, state: Gauss, q_meas: Array) -> tuple[float, float]:
    """Take the active joints (2,), rad; see ``_update`` for what is returned."""
    J, innovation = _innovation(model, state, q_meas)
    PH, S = _seen(state.covariance, J, 1.0, noise.encoder**2)
    return _update(state, PH, S, innovation)


@njit
def correct(model: Model, noise: Noise, state: Gauss, q_meas: Array, dt: float) -> bool:
    """Take the active joints (2,), rad, and see whether the robot was struck in the last dt."""
    J, innovation = _innovation(model, state, q_meas)
    PH, S = _seen(state.covariance, J, 1.0, noise.encoder**2)
    weighted = apply(inverse(S), innovation)
    struck = innovation[0] * weighted[0] + innovation[1] * weighted[1] > noise.shock_gate
    if struck:
        allow_for_shock(noise, state, dt)
        PH, S = _seen(state.covariance, J, 1.0, noise.encoder**2)
    _update(state, PH, S, innovation)
    return struck


@njit
def correct_position(state: Gauss, x_meas: Array, deviation: float) -> tuple[float, float]:
    """Take an external position (2,), m, with its standard deviation, m; see ``_update`` for what is returned."""
    PH, S = _seen(state.covariance, np.eye(2), 0.0, deviation**2)
    return _update(state, PH, S, x_meas - state.mean[0:2])


@njit
def mirror(model: Model, state: Gauss, image: Gauss) -> bool:
    """The same joint angles and velocities in the other assembly mode, with its covariance; false where undefined."""
    x, x_dot = state.mean[0:2].copy(), state.mean[2:4].copy()
    kin = state_of_platform(model, x, x_dot)
    mode = 1.0 if singularity(model, kin.A_r) > 0.0 else -1.0
    other = direct_geometric_model(model, kin.q_a, -mode)
    J = inverse(kinematics(model, kin.q_a, other, np.zeros(2)).J_inv)
    T = np.zeros((STATES, STATES))
    T[0:2, 0:2] = J @ kin.J_inv
    T[2:4, 2:4] = T[0:2, 0:2]
    T[4, 4] = 1.0
    T[5, 5] = 1.0
    image.mean[0:2] = other
    image.mean[2:4] = apply(J, kin.q_a_dot)
    image.mean[4:6] = state.mean[4:6]
    image.covariance[:, :] = T @ state.covariance @ T.T
    image.x_ddot[:] = 0.0
    same = inverse_geometric_model(model, other)
    near = abs(same[0] - kin.q_a[0]) + abs(same[1] - kin.q_a[1]) < 1e-6  # still in this working mode
    return bool(near and np.isfinite(image.mean).all())


@njit
def side(model: Model, state: Gauss) -> tuple[float, bool]:
    """s, and whether the distal links are nearer to stretched than to folded."""
    kin = state_of_platform(model, state.mean[0:2].copy(), np.zeros(2))
    s = singularity(model, kin.A_r)
    return s, kin.A_r[0, 0] * kin.A_r[1, 0] + kin.A_r[0, 1] * kin.A_r[1, 1] < 0.0


@njit
def predict_all(
    model: Model, noise: Noise, passage: Passage, bank: Bank, testing: bool, tau: Array, dt: float
) -> None:
    """All filters that run, over dt in steps of at most MAX_STEP."""
    steps = int(np.ceil(dt / MAX_STEP - 1e-6))
    for _ in range(steps):
        predict(model, noise, bank.main, tau, dt / steps)
        predict(model, passage.noise, bank.same, tau, dt / steps)
        if testing:
            predict(model, passage.noise, bank.image, tau, dt / steps)


@njit
def observe(
    model: Model, noise: Noise, passage: Passage, bank: Bank, belief: Array, tau: Array, dt: float, q_meas: Array
) -> None:
    """One sample: the filters and the belief about the assembly mode, all changed in place.

    Args:
        belief: (BELIEF,) assembly mode; log-odds of it; armed; testing; log-likelihood ratio of the two filters of the
            test; sum of each one's squared normalised innovations; samples; how often the image was the robot; mean
            of the former while the assembly mode is known; over the last samples; whether that makes it doubtful;
            log-odds of it by what else was seen (``core.hindsight``); whether the state was where the working mode ends.
        tau: (2,) commanded since the last sample, N m.
        dt: since the last sample, s.
        q_meas: (2,) rad.
    """
    if dt > LONG or not np.isfinite(bank.main.mean).all():
        begin_again(model, noise, bank, belief, q_meas)
        return
    testing = belief[TESTING] > 0.0
    predict_all(model, noise, passage, bank, testing, tau, dt)
    shocked = correct(model, noise, bank.main, q_meas, dt)
    if shocked and testing:  # the two filters of the test know nothing of the blow
        belief[TESTING], belief[LOG_ODDS], belief[ARMED] = 0.0, 0.0, 1.0
        testing = False
    same, spread_same = innovate(model, passage.noise, bank.same, q_meas)
    if testing:
        image, spread_image = innovate(model, passage.noise, bank.image, q_meas)
        if np.isfinite(same + image):
            weigh(belief, same, spread_same, image, spread_image)
    elif belief[ARMED] == 0.0 and not shocked and np.isfinite(same):
        belief[MISFIT_NOW] += min(dt / DOUBT_TIME, 1.0) * (0.5 * same - belief[MISFIT_NOW])
        if belief[MISFIT_NOW] > DOUBT * max(1.0, belief[MISFIT_KNOWN]):
            belief[DOUBTFUL] = 1.0
        else:
            excess = belief[MISFIT_NOW] - belief[MISFIT_KNOWN]
            belief[MISFIT_KNOWN] += min(dt / (RISE if excess > 0.0 else FORGET), 1.0) * excess
    if shocked or not np.isfinite(same):
        copy(bank.main, bank.same)
    judge_passage(model, passage, bank, belief)


@njit
def copy(source: Gauss, target: Gauss) -> None:
    """Make the target the source."""
    target.mean[:] = source.mean
    target.covariance[:, :] = source.covariance
    target.x_ddot[:] = source.x_ddot


@njit
def weigh(belief: Array, same: float, spread_same: float, image: float, spread_image: float) -> None:
    """Take one measurement's two likelihoods into the belief.

    Where even the better filter fits worse than the noise that it was told, now or while the assembly mode was known,
    the log-odds shrink by that factor, and where both fit alike badly they vanish: a wrong model makes the test
    unsure, not wrong. CORRELATED and CONTRAST were chosen on simulated campaigns: what comes out ranks, it is not a
    calibrated probability.
    """
    belief[RATIO] += 0.5 * (image + spread_image - same - spread_same)
    belief[MISFIT_SAME] += same
    belief[MISFIT_IMAGE] += image
    belief[SAMPLES] += 1.0
    better, worse = min(belief[MISFIT_SAME], belief[MISFIT_IMAGE]), max(belief[MISFIT_SAME], belief[MISFIT_IMAGE])
    contrast = smooth_step(worse / better, CONTRAST[0], CONTRAST[1])
    misfit = max(1.0, belief[MISFIT_KNOWN], better / (2.0 * belief[SAMPLES]))
    belief[LOG_ODDS] = belief[SEEN] + contrast * belief[RATIO] / (CORRELATED * misfit)


@njit
def log_odds_of_side(model: Model, state: Gauss, s: float) -> float:
    """Of the sign of s, as the covariance has it: logit of the normal distribution at |s| over its deviation."""
    slope = np.empty(2)
    for i in range(2):
        shifted = state.mean[0:2].copy()
        shifted[i] += STEP
        slope[i] = (singularity(model, state_of_platform(model, shifted, np.zeros(2)).A_r) - s) / STEP
    P = state.covariance
    variance = slope[0] ** 2 * P[0, 0] + 2.0 * slope[0] * slope[1] * P[0, 1] + slope[1] ** 2 * P[1, 1]
    wrong = 0.5 * math.erfc(abs(s) / math.sqrt(2.0 * max(variance, 1e-30)))
    return min(math.log1p(-wrong) - math.log(max(wrong, 1e-300)), CERTAIN)


@njit
def judge_passage(model: Model, passage: Passage, bank: Bank, belief: Array) -> None:
    """Begin, go on with or end the test of crossed against bounced; see ``observe``.

    Where the distal links are folded there is nothing to test: the image is a whole turn of them away, and the
    joints tell the side as well as they tell s. Where a leg stretches or folds the robot may be on its way into another
    working mode, of which nothing is known here: the belief is unsure until it is told. So it is, until the next passage,
    where the state is suddenly on the other side.
    """
    main = bank.main
    s, stretched = side(model, main)
    type1 = type1_distance(model, state_of_platform(model, main.mean[0:2], main.mean[2:4]))
    if not (np.isfinite(s) and type1 >= LOST * model.min_type1):
        belief[STRAYED] = 1.0
    if belief[STRAYED] > 0.0:
        belief[LOG_ODDS:SWAPS], belief[SEEN] = 0.0, 0.0
        return
    mode = 1.0 if s > 0.0 else -1.0
    if mode * belief[MODE] < 0.0 and belief[ARMED] == 0.0 and abs(s) >= passage.armed:
        belief[LOG_ODDS:SWAPS] = 0.0
        belief[MODE] = mode
        return
    if abs(s) < passage.armed:
        belief[TESTING:SWAPS] = 0.0
        belief[ARMED] = 1.0
        belief[LOG_ODDS] = 0.0 if stretched else log_odds_of_side(model, main, s)
    elif belief[ARMED] > 0.0 and not stretched:
        belief[LOG_ODDS] = log_odds_of_side(model, main, s)
        belief[ARMED] = 0.0 if abs(s) >= passage.begin else 1.0
    elif belief[ARMED] > 0.0 and abs(s) >= passage.begin:
        belief[ARMED] = 0.0
        if mirror(model, main, bank.image):
            copy(main, bank.same)
            belief[TESTING] = 1.0
    elif belief[DOUBTFUL] > 0.0 and passage.begin <= abs(s) < DOUBT_S and mirror(model, main, bank.image):
        copy(main, bank.same)
        belief[TESTING:SWAPS] = 0.0
        belief[TESTING], belief[LOG_ODDS] = 1.0, 0.0
    elif belief[TESTING] > 0.0 and abs(belief[LOG_ODDS]) >= passage.log_odds:
        if belief[LOG_ODDS] < 0.0:
            copy(bank.image, main)
            copy(bank.image, bank.same)
            mode = -mode
            belief[SWAPS] += 1.0
        belief[TESTING] = 0.0
        belief[LOG_ODDS] = CERTAIN
    belief[DOUBTFUL] = 0.0
    if belief[TESTING] > 0.0 or belief[ARMED] > 0.0:
        belief[MISFIT_NOW] = 0.0
    belief[MODE] = mode
