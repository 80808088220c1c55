"""The belief about the assembly mode, and Wald's sequential probability ratio test
(SPRT) of crossed against bounced.

Crossed and bounced give the same q_a(t) with the end effector mirrored about the line
of the elbows. After each passage near the locus a second filter starts from the mirror
image of the first one's state and covariance. Both predict the joints with their own
dynamics, and the log-likelihood ratio of the measured joints decides between the
hypotheses "same" and "image". The same test begins where the joints suddenly no longer
fit the believed motion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from operator import attrgetter

CERTAIN = 20.0  # log-odds of a decided belief
CORRELATED = 10.0  # samples with correlated innovations, which count as one
# misfit over the known one, averaged over so many s, that begins a test ...
DOUBT, DOUBT_TIME = 20.0, 5e-3
DOUBT_S = 0.4  # ... where |s| is below this: beyond it a misfit is a push
# s over which the misfit in a known assembly mode is averaged, rising and falling
RISE, FORGET = 0.05, 5.0
# ratio of the two misfits from which the test begins to count, and counts fully ...
CONTRAST = 1.2, 1.6
# ... and the same where neither filter fits as the robot did while its side was known,
STRANGE_CONTRAST = 6.0, 12.0
# which begins, and fully is so, at this ratio of the lesser misfit to the known one
STRANGE = 1.5, 3.0
LEAST_KNOWN = 0.1  # least misfit that counts as known
# log-odds that CORRELATED samples add at most, over the logarithm of the misfits' ratio
PACE = 1.5


@dataclass(slots=True)
class Belief:
    """The belief about the assembly mode of one block of A_r.

    Attributes:
        mode: sign of s, of the main filter; 0 before the first sample.
        log_odds: of that mode.
        armed: whether the robot is, or was, so near to the locus that the mode is
            unknown until the test has decided.
        testing: whether the two filters of the test run.
        ratio: half the difference of the sums of ln det of the innovations'
            covariances, image less same.
        misfit_same, misfit_image: sums of the squared normalised innovations.
        samples: of the test.
        swaps: number of tests that the image has won.
        misfit_known: mean squared normalised innovation, halved, while the mode is
            known.
        misfit_now: the same over the last samples.
        doubtful: whether ``misfit_now`` makes the mode doubtful.
        before: log-odds that the test had before its filters began anew.
        seen: log-odds of the mode by external positions
            (``estimation.out_of_sequence``).
        strayed: whether the state was where the working mode ends.
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
        """Return a belief of its own with the same values."""
        return Belief(*_values_of(self))

    def end_test(self) -> None:
        """End the test, and begin the next one's sums anew."""
        self.testing = False
        self.before = self.ratio = self.misfit_same = self.misfit_image = 0.0
        self.samples = 0

    def pause(self) -> None:
        """Keep the test's log-odds while its filters have to begin anew."""
        found = self.log_odds - self.seen
        self.end_test()
        self.before, self.armed = found, True

    def unsure(self) -> None:
        """End the test with nothing known for or against the mode."""
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
        """Update the log-odds with the likelihoods of one measurement.

        The noise of the filters is known but for a factor, which each estimates from
        its own innovations: of N samples of a size the log-likelihood ratio is
        N size / 2 times the logarithm of the ratio of the sums of their squares, and
        the difference of the spreads. So a model that fits badly on both sides gives no
        side an advantage; where both fit alike the log-odds vanish. How different they
        have to be depends on the likelier one: if it fits as the robot did while its
        side was known, little is enough; if it fits much worse, both may be wrong. One
        outlier is no proof: the pace of the log-odds is limited. The constants were
        chosen on simulated robots.

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
        """Update, while the mode is known, how well the model fits and whether that
        makes the mode doubtful.

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
        """Return (assembly mode, confidence in it, 0.5 to 1) of the likelier
        hypothesis.
        """
        odds = self.log_odds
        if odds >= 0.0:
            return self.mode, 1.0 / (1.0 + math.exp(-odds))
        return -self.mode, 1.0 / (1.0 + math.exp(odds))


_values_of = attrgetter(*(field.name for field in fields(Belief)))


def _step(value: float, begin: float, end: float, *, smooth: bool = False) -> float:
    """Return a step from 0 at ``begin`` to 1 at ``end``."""
    z = min(max((value - begin) / (end - begin), 0.0), 1.0)
    return z * z * z * (10.0 + z * (6.0 * z - 15.0)) if smooth else z


def log_odds_of_side(s: float, variance: float) -> float:
    """Return the log-odds of the sign of s by its variance: the logit of the normal
    distribution at |s| over its deviation.
    """
    wrong = 0.5 * math.erfc(abs(s) / math.sqrt(2.0 * max(variance, 1e-30)))
    return min(math.log1p(-wrong) - math.log(max(wrong, 1e-300)), CERTAIN)
