"""Crossed or bounced: the belief about the assembly mode, and Wald's sequential test of
two filters.

Crossed and bounced give the same q_a(t) with the end effector mirrored about the line
of the elbows. After each passage of the locus a second filter starts from the mirror
image of the first one's state and covariance; both predict the joints with their own
dynamics, and the log-likelihood ratio of what is measured tells which of the two is the
robot. The same test begins where the joints suddenly fit the believed motion no longer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

CERTAIN = 20.0  # log-odds at which a belief is kept
CORRELATED = (
    10.0  # samples over which the innovations hang together: so many count as one
)
DOUBT, DOUBT_TIME = (
    20.0,
    5e-3,
)  # misfit over the known one, averaged over so many s, that begins a test ...
# ... where |s| is below this: farther from the locus it is somebody's push, not the
# other side
DOUBT_S = 0.4
RISE, FORGET = (
    0.05,
    5.0,
    # s over which the misfit in a known assembly mode is averaged, up and down: a model
    # stays wrong
)
CONTRAST = (
    1.2,
    1.6,
    # how many times worse the less likely filter has to fit before the test begins to
    # count, and fully does ...
)
STRANGE_CONTRAST = (
    6.0,
    12.0,
)  # ... the same where neither fits as the robot did while its side was known ...
STRANGE = (
    1.5,
    3.0,
    # ... which begins, and is so, from this many times that misfit on, of the likelier
    # one
)
LEAST_KNOWN = 0.1  # misfit that the robot is taken to have had at least then
# times the logarithm of how much worse one fits than the other: log-odds that
# CORRELATED samples tell at most
PACE = 1.5


@dataclass(slots=True)
class Belief:
    """What is believed of the assembly mode.

    Attributes:
        mode: sign of s, of the filter that serves; 0 before the first sample.
        log_odds: of it.
        armed: the robot is, or was, so near to the locus that the mode is unknown until
            the test has decided.
        testing: the two filters of the test run.
        ratio: half of what the sum of ln det of the image's innovations' covariances is
            above that of the other.
        misfit_same, misfit_image: sums of their squared normalised innovations.
        samples: of the test.
        swaps: how often the image was the robot.
        misfit_known: mean of the squared normalised innovation, halved, while the mode
            is known.
        misfit_now: the same over the last samples.
        doubtful: whether that makes the mode doubtful.
        before: log-odds by what the test found before its filters began anew.
        seen: log-odds of the mode by what else was seen
            (``estimation.out_of_sequence``).
        strayed: the state was where the working mode ends.
    """

    mode: float = 0.0
    log_odds: float = 0.0
    armed: bool = False
    testing: bool = False
    ratio: float = 0.0
    misfit_same: float = 0.0
    misfit_image: float = 0.0
    samples: int = 0
    swaps: int = 0
    misfit_known: float = 0.0
    misfit_now: float = 0.0
    doubtful: bool = False
    before: float = 0.0
    seen: float = 0.0
    strayed: bool = False

    def copy(self) -> Belief:
        """Another one."""
        return Belief(
            self.mode,
            self.log_odds,
            self.armed,
            self.testing,
            self.ratio,
            self.misfit_same,
            self.misfit_image,
            self.samples,
            self.swaps,
            self.misfit_known,
            self.misfit_now,
            self.doubtful,
            self.before,
            self.seen,
            self.strayed,
        )

    def end_test(self) -> None:
        """No test, and nothing counted for the next one."""
        self.testing = False
        self.before = self.ratio = self.misfit_same = self.misfit_image = 0.0
        self.samples = 0

    def pause(self) -> None:
        """The test's filters have to begin anew: what it has found stays."""
        found = self.log_odds - self.seen
        self.end_test()
        self.before, self.armed = found, True

    def unsure(self) -> None:
        """Nothing is known for or against the mode, and no test runs."""
        self.end_test()
        self.log_odds, self.armed = 0.0, False

    def weigh(
        self,
        same: float,
        spread_same: float,
        image: float,
        spread_image: float,
        size: int,
    ) -> None:
        """Take one measurement's two likelihoods in.

        The noise that the filters were told is right but for a factor, which each
            estimates from its own innovations: of N
        samples of a size the log-likelihood ratio is N size / 2 times the logarithm of
        the ratio of the sums of their squares, and the difference of the spreads. So a
        model that fits badly on both sides gives no side an advantage; where both fit
        alike the log-odds vanish. How different they have to be depends on the likelier
        one: if it fits as the robot did while its side was known, little is enough; if
        it fits much worse, the model lacks something, and both may be wrong. One
        outlier is no proof either: the log-odds change by a limited pace. The constants
        were chosen on simulated robots.

        Args:
            same, image: squared normalised innovations of the two filters.
            spread_same, spread_image: ln det of the innovations' covariances.
            size: of an innovation.
        """
        self.ratio += 0.5 * (spread_image - spread_same)
        self.misfit_same += same
        self.misfit_image += image
        self.samples += 1
        better, worse = sorted((self.misfit_same, self.misfit_image))
        known = min(max(self.misfit_known, LEAST_KNOWN), 0.5 * size)
        strange = _step(0.5 * better / (self.samples * known), *STRANGE)
        begin, full = (
            plain + strange * (other - plain)
            for plain, other in zip(CONTRAST, STRANGE_CONTRAST, strict=True)
        )
        fit = 0.5 * size * self.samples * math.log(self.misfit_image / self.misfit_same)
        misfit = max(1.0, better / (size * self.samples))
        contrast = _step(worse / better, begin, full, smooth=True)
        found = (
            self.seen
            + self.before
            + contrast * (fit + self.ratio) / (CORRELATED * misfit)
        )
        pace = PACE * math.log(worse / better) / CORRELATED
        self.log_odds = min(max(found, self.log_odds - pace), self.log_odds + pace)

    def fit(self, misfit: float, dt: float) -> None:
        """While the mode is known: how well the model fits, and whether that makes the
        mode doubtful.

        Args:
            misfit: squared normalised innovation.
            dt: since the last sample, s.
        """
        known, now = self.misfit_known, self.misfit_now
        self.misfit_now = now = now + (dt / DOUBT_TIME if dt < DOUBT_TIME else 1.0) * (
            0.5 * misfit - now
        )
        if now > DOUBT * known and now > DOUBT:
            self.doubtful = True
            return
        excess = now - known
        time = RISE if excess > 0.0 else FORGET
        self.misfit_known = known + (dt / time if dt < time else 1.0) * excess

    def as_seen(self) -> tuple[float, float]:
        """(assembly mode, confidence in it, 0.5 to 1): the image's where that is the
        likelier one.
        """
        odds = self.log_odds
        if odds >= 0.0:
            return self.mode, 1.0 / (1.0 + math.exp(-odds))
        return -self.mode, 1.0 / (1.0 + math.exp(odds))


def _step(value: float, begin: float, end: float, *, smooth: bool = False) -> float:
    """From 0 at ``begin`` to 1 at ``end``."""
    z = min(max((value - begin) / (end - begin), 0.0), 1.0)
    return z * z * z * (10.0 + z * (6.0 * z - 15.0)) if smooth else z


def log_odds_of_side(s: float, variance: float) -> float:
    """Of the sign of s, as its variance has it: logit of the normal distribution at |s|
    over its deviation.
    """
    wrong = 0.5 * math.erfc(abs(s) / math.sqrt(2.0 * max(variance, 1e-30)))
    return min(math.log1p(-wrong) - math.log(max(wrong, 1e-300)), CERTAIN)
