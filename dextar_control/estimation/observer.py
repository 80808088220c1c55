"""The observer: the main filter, the two filters of the test of crossed against
bounced, and the belief about the side of the locus.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from operator import itemgetter

import numpy as np
from numpy.typing import ArrayLike

from dextar_control.contract.settings import CrossingTestSettings
from dextar_control.estimation.belief import CERTAIN, DOUBT_S, Belief, log_odds_of_side
from dextar_control.estimation.filters import FILTER, NOISE, TOLD, filters_of
from dextar_control.estimation.records import ESTIMATE
from dextar_control.model.model import Model
from dextar_control.symbols.functions import Fast, Results
from dextar_control.symbols.record import Layout, Record
from dextar_control.symbols.types import Array

REST_SPEED = 1e-3  # m/s, standard deviation of a robot at rest
# s of one prediction; a longer gap is predicted in several
MAX_STEP = 1e-3 * (1.0 + 1e-6)
LONG = 0.1  # s of a gap over which nothing is predicted
UNKNOWN = math.nan, math.nan
# N m at a joint that a test allows for, however well the model has fitted
LEAST_LACKING = 5e-4
WALK = 0.5  # 1/sqrt(s), of such a torque's random walk over itself
# m/s of the platform under either hypothesis, from which a sample counts in a test
MOVING = 5e-3
LOST = 0.5  # of the least distance to Type 1, below which the working mode is unsure


@dataclass(slots=True)
class Side:
    """One block of A_r: the belief about its side of the locus, and the image filter.

    Attributes:
        belief: about the block's assembly mode.
        told: record of ``filters.TOLD``: the main filter with respect to the block's
            locus, and the last sample's likelihood.
        image: filter from the main one's mirror image in this block, with less noise.
        p: the robot's parameters in the image's working mode, which may be another one.
        mirror: the function that makes the image.
        follow: the function that takes a sample into the image.
        shown: mode and log-odds of the belief that the estimate has.
    """

    belief: Belief
    told: Record
    image: Record
    p: Array
    mirror: Fast
    follow: Fast
    shown: tuple[float, float] = UNKNOWN


class Observer:
    """The filters of one robot, changed in place.

    Args:
        model: of the robot, as the controller knows it.
        min_type1: its least distance to Type 1.
        estimate: the record that it keeps; one of its own when None.

    Attributes:
        main: the filter that gives the estimate.
        same: from the main one's state, with less noise: the hypothesis that the main
            filter is right; without a test it measures how well the model fits.
        noise: of the main filter; test_noise: of the others.
        crossing_test: the settings of a test, which allows for the torques that are not
            modelled of before it, up to ``max_disturbance``.
        sides: of the blocks of A_r, mostly one, whose belief, told and image are the
            observer's.
        modes: (assembly mode, confidence in it) of each block when ``tell_side`` was
            last called.
        estimate: of the main filter, with the mode of least confidence.
    """

    def __init__(
        self, model: Model, min_type1: float, estimate: Record | None = None
    ) -> None:
        self.n, self._sure_type1 = model.n, LOST * min_type1
        self.layout = Layout("filter", model.n, FILTER)
        noise = Layout("noise", model.n, NOISE)
        self.main, self.same = self.layout.make(), self.layout.make()
        self.noise, self.test_noise = noise.make(), noise.make()
        self.estimate = estimate or Layout("estimate", model.n, ESTIMATE).make()
        self.estimate.s = math.nan
        self.crossing_test = CrossingTestSettings(*[0.0] * 8)
        self._finite = True
        self._lacking = [0.0] * model.n
        self._p, self._library = model.p, filters_of(model.mechanism)
        self._model = model
        self._rows = [len(rows) for rows in model.blocks]
        told = Layout("told", model.n, TOLD)
        every = np.zeros(len(model.blocks) * told.size)
        main, shown = self.main.numbers, self.estimate.numbers
        places = {
            "p": model.p,
            "filter": main,
            "estimate": shown,
            "estimate_next": shown,
            "told": every,
        }
        self._advance = self._library.fast(
            "advance",
            **places,
            filter_next=main,
            same=self.same.numbers,
            same_next=self.same.numbers,
            noise=self.noise.numbers,
            test_noise=self.test_noise.numbers,
        )
        self._given, given = self._advance.views(), self._advance.arguments
        self._look = self._library.fast("look", **places)
        self.sides = []
        for block, numbers in enumerate(every.reshape(-1, told.size)):
            image, p = self.layout.make(), np.array(model.p)
            follow = self._library.fast(
                "follow",
                p=p,
                noise=self.test_noise.numbers,
                filter=image.numbers,
                filter_next=image.numbers,
                tau=given.tau,
                dt=given.dt,
                q_meas=given.q_meas,
            )
            self.sides.append(
                Side(
                    Belief(),
                    told.of(numbers),
                    image,
                    p,
                    self._library.fast(f"mirror_{block}"),
                    follow,
                )
            )
        self.modes: list[tuple[float, float]] = []
        self._steps = {name: self._library.fast(name) for name in _OWN}

    told = property(lambda self: self.sides[0].told)
    image = property(lambda self: self.sides[0].image)

    @property
    def belief(self) -> Belief:
        """The belief about the first block."""
        return self.sides[0].belief

    @belief.setter
    def belief(self, belief: Belief) -> None:
        self.sides[0].belief = belief

    def _step(
        self,
        name: str,
        state: Record,
        *arguments: ArrayLike,
        noise: Record | None = None,
        p: Array | None = None,
    ) -> Results:
        """Change a state by one of the filter's steps; the step's other results."""
        fast = self._steps[name]
        given = fast.arguments
        if noise is not None:
            given.noise[:] = noise.numbers
        if hasattr(given, "p"):
            given.p[:] = self._p if p is None else p
        given.filter[:] = state.numbers
        for place, argument in zip(
            (getattr(given, key) for key in _OWN[name]), arguments, strict=True
        ):
            place[:] = argument
        fast.run()
        results = fast.results
        state.numbers[:] = results.filter_next
        return results

    def predict(self, state: Record, noise: Record, tau: Array, dt: float) -> None:
        """Predict a filter under torques tau (n,), N m, over dt, s."""
        self._step("predict", state, tau, dt, noise=noise)

    def correct(self, state: Record, noise: Record, q_meas: Array, dt: float) -> bool:
        """Correct a filter with the active joints (n,), rad; whether the robot was
        struck in the last dt, s.
        """
        return bool(self._step("correct", state, q_meas, dt, noise=noise).struck[0])

    def innovate(
        self, state: Record, noise: Record, q_meas: Array, block: int = 0
    ) -> tuple[float, float]:
        """Correct a filter with the active joints (n,), rad.

        Returns:
            (normalised square of the block's innovation, ln det of its covariance).
        """
        found = self._step("innovate", state, q_meas, noise=noise)
        return found.square.item(block), found.spread.item(block)

    def correct_position(
        self, state: Record, x_meas: Array, deviation: float
    ) -> tuple[float, float, float]:
        """Correct a filter with an external position (n,), m, of a standard deviation,
        m.

        Returns:
            (squared normalised distance, ln det of its covariance, distance, m).
        """
        found = self._step("correct_position", state, x_meas, deviation)
        return found.square.item(), found.spread.item(), found.distance.item()

    def allow_for_unseen_blow(self, state: Record) -> None:
        """Add the covariance of an unseen blow along t_s to a filter."""
        self._step("unseen_blow", state, noise=self.noise)

    def mirror(self, state: Record, image: Record, block: int = 0) -> bool:
        """Make ``image`` the mirror image of a state in a block; false where that is
        not in this working mode.
        """
        return self._mirror(state, image, block) and bool(
            (self.sides[block].mirror.results.p_image == self._p).all()
        )

    def _mirror(self, state: Record, image: Record, block: int) -> bool:
        """Make the mirror image in any working mode; false where a leg of it is too
        near to Type 1.
        """
        found = self.sides[block].mirror(self._p, state.numbers)
        image.numbers[:] = found.image
        mean = 4 * self.n
        return bool(
            found.type1[0] >= self._sure_type1
            and np.isfinite(image.numbers[:mean]).all()
        )

    def look_again(self) -> None:
        """Update what depends on the main filter after it was changed."""
        self._look.run()

    def direct_model(self, q_a: Array, assembly_mode: float | Array) -> Array:
        """Return the platform position (n,), m, of the joints (n,), rad, with sign(s) =
        assembly_mode; the nearest to the last one where it is solved.
        """
        return self._model.direct_geometric_model(q_a, assembly_mode, self.main.x)

    def begin(self, x: Array, speed: float) -> None:
        """Begin at x (n,), m, known from the joints, with a standard deviation of the
        velocity about zero, m/s.
        """
        self.main.numbers[:] = self._steps["begin"](
            self._p, self.noise.numbers, x, speed
        ).filter
        self._restart_comparison()
        self._finite = True
        for side in self.sides:
            side.shown = UNKNOWN
        self.look_again()

    def begin_again(self, q_meas: Array) -> None:
        """Begin again from the joints (n,), rad, alone, in the mode believed so far but
        unsure of it.
        """
        modes = np.array([side.belief.mode or 1.0 for side in self.sides])
        self.begin(self.direct_model(q_meas, modes), self.noise.shock_speed)
        for side in self.sides:
            side.belief.unsure()
            side.belief.seen = 0.0

    def predict_all(self, tau: Array, dt: float) -> None:
        """Predict all filters under tau (n,), N m, over dt, s, in steps of at most
        MAX_STEP.
        """
        steps = math.ceil(dt / MAX_STEP)
        self._predict_all(tau, dt / steps, steps)

    def _predict_all(self, tau: Array, step: float, steps: int) -> None:
        for _ in range(steps):
            self.predict(self.main, self.noise, tau, step)
            self._step("predict_test", self.same, tau, step, noise=self.test_noise)
            for side in self.sides:
                if side.belief.testing:
                    noise, image = self.test_noise, side.image
                    self._step("predict_test", image, tau, step, noise=noise, p=side.p)

    def observe(self, tau: Array, dt: float, q_meas: Array) -> bool:
        """Take a sample into the filters and the beliefs; whether ``tell_side`` has to
        be called.

        Args:
            tau: torques commanded since the last sample, (n,), N m.
            dt: since the last sample, s.
            q_meas: measured joints, (n,), rad.
        """
        if dt > LONG or not self._finite:
            self.begin_again(q_meas)
            return True
        step, anew = dt, False
        if dt > MAX_STEP:
            steps = math.ceil(dt / MAX_STEP)
            step = dt / steps
            self._predict_all(tau, step, steps - 1)
        given, advance = self._given, self._advance
        given.tau[:], given.q_meas[:], given.dt[0], given.gap[0] = tau, q_meas, step, dt
        advance.run()
        finite, hit, fitting = advance.results.sample.tolist()
        self._finite, struck, fits = finite > 0.0, hit > 0.0, fitting > 0.0
        quiet, armed = fits and not struck, self.crossing_test.unknown_below_abs_s
        for block, side in enumerate(self.sides):
            belief = side.belief
            if belief.testing or belief.armed:
                quiet = False
                if belief.testing:
                    self._weigh(block, side, struck)
        if struck or not fits:
            self._restart_comparison()
        for block, side in enumerate(self.sides):
            # in the order of TOLD
            s, s_variance, type1, folded, square, _ = side.told.numbers.tolist()
            if quiet:
                belief = side.belief
                belief.fit(square, dt)
                if (
                    s * belief.mode >= armed
                    and type1 >= self._sure_type1
                    and not (belief.doubtful or belief.strayed)
                ):
                    continue  # clear of the locus on the side where it was
            self._update_test(block, side, s, s_variance, type1, folded >= 0.0)
            anew = True
        return anew

    def _weigh(self, block: int, side: Side, struck: bool) -> None:
        """Take the sample into a block's test; a blow, which the test's filters do not
        model, ends it.
        """
        belief, told = side.belief, side.told
        if struck:
            belief.unsure()
            belief.armed = True
            return
        side.follow.run()
        found = side.follow.results
        # on its way into another working mode, where the test goes on
        if not found.type1.item() >= self._sure_type1:
            belief.pause()
            return
        # at rest every sample is the same one
        if max(abs(self.main.x_dot).max(), abs(side.image.x_dot).max()) < MOVING:
            return
        image, spread_image = found.fit.reshape(2, -1)[:, block].tolist()
        if math.isfinite(told.square + image):
            rows = self._rows[block]
            belief.weigh(told.square, told.spread, image, spread_image, rows)

    def _restart_comparison(self) -> None:
        """Start the filter of the hypothesis "same" from the main one.

        In a test it and the image allow for as much torque that is not modelled as
        there was while the side was known, and for as much noise of the samples as
        there was then (backlash, a belt that is not in the robot's file).
        """
        noise, misfit = self.test_noise, 1.0
        lacking = self.crossing_test.max_disturbance
        if known := [
            side.belief.misfit_known for side in self.sides if side.belief.testing
        ]:
            lacking = min(max(LEAST_LACKING, *map(abs, self._lacking)), lacking)
            misfit = max(misfit, *known)
        noise.encoder = self.crossing_test.encoder_deviation * math.sqrt(misfit)
        noise.disturbance = noise.disturbance_turn = lacking
        noise.disturbance_walk = WALK * lacking
        self.same.take(self.main)
        self._step("unsure", self.same, noise=noise)

    def _begin_test(self, block: int, side: Side) -> bool:
        """Begin a block's test from the main filter's state and its image, unsure of
        both alike; false where there is no image yet.
        """
        side.belief.armed = not self._mirror(self.main, side.image, block)
        if side.belief.armed:
            return False
        side.p[:] = side.mirror.results.p_image
        side.belief.testing = True
        self._restart_comparison()
        self._step("unsure", side.image, noise=self.test_noise, p=side.p)
        return True

    def _restart_tests(self, side: Side) -> None:
        """Restart the tests of the other sides from the main filter's state, as the
        test of this side begins or ends.
        """
        self._restart_comparison()
        for block, other in enumerate(self.sides):
            if other is not side and other.belief.testing:
                other.belief.pause()
                self._begin_test(block, other)

    def _update_test(
        self,
        block: int,
        side: Side,
        s: float,
        s_variance: float,
        type1: float,
        folded: bool,
    ) -> None:
        """Begin, continue or end a block's test of crossed against bounced.

        Where the distal links are folded there is nothing to test: the image is a whole
        turn of them away, and the joints tell the side as well as they tell s. Where a
        leg comes to Type 1 the robot may be on its way into another working mode, which
        is not modelled here: the belief is unsure until the mode is told. It is unsure
        too, until the robot next comes near the locus, where the state is suddenly on
        the other side.
        """
        belief, told = side.belief, self.crossing_test
        armed, begin = told.unknown_below_abs_s, told.begin_below_abs_s
        if not (math.isfinite(s) and type1 >= self._sure_type1):
            belief.strayed = True
        if belief.strayed:
            belief.unsure()
            belief.seen = 0.0
            return
        near, mode = abs(s), 1.0 if s > 0.0 else -1.0
        if mode * belief.mode < 0.0 and not belief.armed and near >= armed:
            belief.unsure()
            belief.mode = mode
            return
        if near < armed:
            beliefs = [other.belief for other in self.sides]
            if not any(one.armed or one.testing for one in beliefs):
                self._lacking = self.same.d.tolist()
            belief.end_test()
            belief.armed = True
            belief.log_odds = log_odds_of_side(s, s_variance) if folded else 0.0
        elif belief.armed and folded:
            belief.log_odds = log_odds_of_side(s, s_variance)
            belief.armed = near < begin
        elif belief.armed and near >= begin:
            if self._begin_test(block, side):
                self._restart_tests(side)
        elif belief.doubtful and begin <= near < DOUBT_S:
            belief.unsure()
            if self._begin_test(block, side):
                self._restart_tests(side)
        elif belief.testing and abs(belief.log_odds) >= told.log_odds:
            if belief.log_odds < 0.0:
                if (side.p != self._p).any():  # in another working mode
                    belief.strayed = True
                    return
                self.main.take(side.image)
                self._restart_tests(side)
                mode = -mode
                belief.swaps += 1
                self.look_again()
            belief.testing = False
            belief.log_odds = CERTAIN
            self._restart_comparison()
        belief.doubtful = False
        if belief.testing or belief.armed:
            belief.misfit_now = 0.0
        belief.mode = mode

    def tell_side(self) -> None:
        """Write the likelier assembly mode and the confidence in it into the
        estimate.
        """
        for side in self.sides:
            mode, log_odds = side.shown
            if side.belief.mode != mode or side.belief.log_odds != log_odds:
                break
        else:
            return
        for side in self.sides:
            side.shown = side.belief.mode, side.belief.log_odds
        modes = self.modes = [side.belief.as_seen() for side in self.sides]
        self.estimate.assembly_mode, self.estimate.confidence = (
            modes[0] if len(modes) == 1 else min(modes, key=itemgetter(1))
        )

    def is_folded(self) -> bool:
        """Return whether the main filter's distal links are nearer to folded than to
        stretched.
        """
        return bool(self.told.folded >= 0.0)


_OWN = {
    "predict": ("tau", "dt"),
    "predict_test": ("tau", "dt"),
    "correct": ("q_meas", "dt"),
    "innovate": ("q_meas",),
    "correct_position": ("x_meas", "deviation"),
    "unseen_blow": (),
    "unsure": (),
    "begin": ("x", "speed"),
}
