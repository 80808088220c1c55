"""The observer: the filter that serves, the two of the test of crossed against bounced, and the belief about the side."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from dextar_control.estimation.belief import CERTAIN, DOUBT_S, Belief, log_odds_of_side
from dextar_control.estimation.filters import FILTER, NOISE, TOLD, filters_of
from dextar_control.estimation.records import ESTIMATE
from dextar_control.model.model import Model
from dextar_control.symbols.record import Layout, Record
from dextar_control.symbols.types import Array

REST_SPEED = 1e-3  # m/s, standard deviation of a robot at rest
MAX_STEP = 1e-3 * (1.0 + 1e-6)  # s of one prediction; a longer gap is predicted in several
LONG = 0.1  # s of a gap over which nothing is predicted any more
LOST = 0.5  # of the least distance to Type 1, below which the working mode is no longer sure


class Passage(NamedTuple):
    """When the sequential test begins and ends."""

    armed: float  # |s| within which the assembly mode counts as unknown
    begin: float  # |s| outside which the mirror image can be told from the state
    log_odds: float  # that decide


class Observer:
    """The filters of one robot, changed in place.

    Args:
        model: of the robot, as the controller knows it.
        min_type1: its least distance to Type 1.
        estimate: the record that it keeps; one of its own when None.

    Attributes:
        main: the filter that serves.
        same: from the main one's state, told of less noise; while there is no test it tells how well the model fits.
        image: from its mirror image, likewise.
        noise: that the main filter is told of; test_noise: that the other two are.
        belief: about the assembly mode.
        told: where the main filter's mean is with respect to the locus, and by the last sample.
        estimate: what it makes, with the side as ``tell_side`` was last called.
    """

    def __init__(self, model: Model, min_type1: float, estimate: Record | None = None) -> None:
        self.n, self._min_type1 = model.n, min_type1
        self.layout = Layout("filter", model.n, FILTER)
        noise = Layout("noise", model.n, NOISE)
        self.main, self.same, self.image = (self.layout.make() for _ in range(3))
        self.noise, self.test_noise = noise.make(), noise.make()
        self.told = Layout("told", model.n, TOLD).make()
        self.estimate = estimate or Layout("estimate", model.n, ESTIMATE).make()
        self.estimate.s = math.nan
        self.belief, self._side = Belief(), (math.nan, math.nan)
        self.passage = Passage(0.0, 0.0, 0.0)
        self._finite = True
        self._p, self._library = model.p, filters_of(model.mechanism)
        self._model = model
        places = {"p": model.p, "filter": self.main.numbers, "estimate": self.estimate.numbers,
                  "estimate_next": self.estimate.numbers, "told": self.told.numbers}
        self._advance = self._library.fast(
            "advance", **places, filter_next=self.main.numbers, same=self.same.numbers, same_next=self.same.numbers,
            noise=self.noise.numbers, test_noise=self.test_noise.numbers,
        )
        self._given = self._advance.views()
        given = self._advance.arguments
        self._follow_image = self._library.fast(
            "follow", p=model.p, noise=self.test_noise.numbers, filter=self.image.numbers, filter_next=self.image.numbers,
            tau=given.tau, dt=given.dt, q_meas=given.q_meas,
        )
        self._look = self._library.fast("look", **places)
        self._steps = {name: self._library.fast(name) for name in _OWN}

    def _step(self, name: str, state: Record, *arguments: Any, noise: Record | None = None) -> Any:
        """One of the filter's steps on a state, which is changed; its other results."""
        fast = self._steps[name]
        given = fast.arguments
        if noise is not None:
            given.noise[:] = noise.numbers
        if hasattr(given, "p"):
            given.p[:] = self._p
        given.filter[:] = state.numbers
        for place, argument in zip((getattr(given, key) for key in _OWN[name]), arguments, strict=True):
            place[:] = argument
        fast.run()
        results = fast.results
        state.numbers[:] = results.filter_next
        return results

    def predict(self, state: Record, noise: Record, tau: Array, dt: float) -> None:
        """One step of a filter under tau (n,), N m, over dt, s."""
        self._step("predict", state, tau, dt, noise=noise)

    def correct(self, state: Record, noise: Record, q_meas: Array, dt: float) -> bool:
        """Take the active joints (n,), rad; whether the robot was struck in the last dt, s."""
        return bool(self._step("correct", state, q_meas, dt, noise=noise).struck[0])

    def innovate(self, state: Record, noise: Record, q_meas: Array) -> tuple[float, float]:
        """Take the active joints (n,), rad: the innovation's normalised square and ln det of its covariance."""
        found = self._step("innovate", state, q_meas, noise=noise)
        return found.square.item(), found.spread.item()

    def correct_position(self, state: Record, x_meas: Array, deviation: float) -> tuple[float, float, float]:
        """Take an external position (n,), m: squared normalised distance, ln det of its covariance, distance, m."""
        found = self._step("correct_position", state, x_meas, deviation)
        return found.square.item(), found.spread.item(), found.distance.item()

    def allow_for_unseen_blow(self, state: Record) -> None:
        """A blow along t_s that b may have been taken for."""
        self._step("unseen_blow", state, noise=self.noise)

    def mirror(self, state: Record, image: Record) -> bool:
        """Make the image the mirror image of a state; false where that is not defined."""
        found = self._steps["mirror"](self._p, state.numbers)
        image.numbers[:] = found.image
        mean = 3 * self.n
        return bool(found.near[0] > 0.0 and np.isfinite(image.numbers[:mean]).all())

    def look_again(self) -> None:
        """After the main filter was changed."""
        self._look.run()

    def direct_model(self, q_a: Array, assembly_mode: float) -> Array:
        """Platform (n,) of the joints (n,), rad, with sign(s) = assembly_mode; the nearest to the last one where it is solved."""
        return self._model.direct_geometric_model(q_a, assembly_mode, self.main.x)

    def begin(self, x: Array, speed: float) -> None:
        """A robot at x (n,), m, known from its joints; speed: standard deviation of its velocity about zero, m/s."""
        self.main.numbers[:] = self._steps["begin"](self._p, self.noise.numbers, x, speed).filter
        self.same.take(self.main)
        self._finite, self._side = True, (math.nan, math.nan)
        self.look_again()

    def begin_again(self, q_meas: Array) -> None:
        """The joints (n,) are all that is known: they are taken in the mode believed so far, unsure of it."""
        self.begin(self.direct_model(q_meas, self.belief.mode or 1.0), self.noise.shock_speed)
        self.belief.unsure()
        self.belief.seen = 0.0

    def predict_all(self, tau: Array, dt: float) -> None:
        """All filters that run, over dt, s, in steps of at most MAX_STEP."""
        steps = math.ceil(dt / MAX_STEP)
        self._predict_all(tau, dt / steps, steps)

    def _predict_all(self, tau: Array, step: float, steps: int) -> None:
        for _ in range(steps):
            self.predict(self.main, self.noise, tau, step)
            self.predict(self.same, self.test_noise, tau, step)
            if self.belief.testing:
                self.predict(self.image, self.test_noise, tau, step)

    def observe(self, tau: Array, dt: float, q_meas: Array) -> None:
        """One sample: the filters and the belief.

        Args:
            tau: (n,) commanded since the last sample, N m.
            dt: since the last sample, s.
            q_meas: (n,) rad.
        """
        belief, advance = self.belief, self._advance
        if dt > LONG or not self._finite:
            self.begin_again(q_meas)
            return
        step = dt
        if dt > MAX_STEP:
            steps = math.ceil(dt / MAX_STEP)
            step = dt / steps
            self._predict_all(tau, step, steps - 1)
        given = self._given
        given.tau[:], given.q_meas[:], given.dt[0], given.gap[0] = tau, q_meas, step, dt
        advance.run()
        s, s_variance, type1, folded, finite, hit, square, spread = self.told.numbers.tolist()  # in the order of TOLD
        self._finite, struck, fits = finite > 0.0, hit > 0.0, math.isfinite(square)
        if struck and belief.testing:  # the two filters of the test know nothing of the blow
            belief.testing, belief.log_odds, belief.armed = False, 0.0, True
        if belief.testing:
            self._follow_image.run()
            image, spread_image = self._follow_image.results.fit.tolist()
            if math.isfinite(square + image):
                belief.weigh(square, spread, image, spread_image)
        elif not belief.armed and not struck and fits:
            belief.fit(square, dt)
        if struck or not fits:
            self.same.take(self.main)
        self._judge_passage(s, s_variance, type1, folded >= 0.0)

    def _judge_passage(self, s: float, s_variance: float, type1: float, folded: bool) -> None:
        """Begin, go on with or end the test of crossed against bounced.

        Where the distal links are folded there is nothing to test: the image is a whole turn of them away, and the
        joints tell the side as well as they tell s. Where a leg stretches or folds the robot may be on its way into another
        working mode, of which nothing is known here: the belief is unsure until it is told. So it is, until the next passage,
        where the state is suddenly on the other side.
        """
        belief, passage = self.belief, self.passage
        if not (math.isfinite(s) and type1 >= LOST * self._min_type1):
            belief.strayed = True
        if belief.strayed:
            belief.unsure()
            belief.seen = 0.0
            return
        near, mode = abs(s), 1.0 if s > 0.0 else -1.0
        if mode * belief.mode < 0.0 and not belief.armed and near >= passage.armed:
            belief.unsure()
            belief.mode = mode
            return
        if near < passage.armed:
            belief.end_test()
            belief.armed = True
            belief.log_odds = log_odds_of_side(s, s_variance) if folded else 0.0
        elif belief.armed and folded:
            belief.log_odds = log_odds_of_side(s, s_variance)
            belief.armed = near < passage.begin
        elif belief.armed and near >= passage.begin:
            belief.armed = False
            if self.mirror(self.main, self.image):
                self.same.take(self.main)
                belief.testing = True
        elif belief.doubtful and passage.begin <= near < DOUBT_S and self.mirror(self.main, self.image):
            self.same.take(self.main)
            belief.end_test()
            belief.testing, belief.log_odds = True, 0.0
        elif belief.testing and abs(belief.log_odds) >= passage.log_odds:
            if belief.log_odds < 0.0:
                self.main.take(self.image)
                self.same.take(self.image)
                mode = -mode
                belief.swaps += 1
                self.look_again()
            belief.testing = False
            belief.log_odds = CERTAIN
        belief.doubtful = False
        if belief.testing or belief.armed:
            belief.misfit_now = 0.0
        belief.mode = mode

    def tell_side(self) -> None:
        """Into the estimate."""
        side = self.belief.mode, self.belief.log_odds
        if side != self._side:
            self._side = side
            self.estimate.assembly_mode, self.estimate.confidence = self.belief.as_seen()

    def is_folded(self) -> bool:
        """Whether the main filter's distal links are nearer to folded than to stretched."""
        return self.told.folded >= 0.0


_OWN = {"predict": ("tau", "dt"), "correct": ("q_meas", "dt"), "innovate": ("q_meas",),
        "correct_position": ("x_meas", "deviation"), "unseen_blow": (), "begin": ("x", "speed"), "mirror": ()}
