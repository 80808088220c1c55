"""``observer``: an estimator that serves what the observer's main filter believes."""

from __future__ import annotations

import numpy as np

from dextar_control.contract.settings import Settings
from dextar_control.estimation.belief import CERTAIN, Belief
from dextar_control.estimation.estimate import Estimator
from dextar_control.estimation.joint_filter import JointFilter
from dextar_control.estimation.observer import REST_SPEED, Observer, Passage
from dextar_control.model.model import Model
from dextar_control.symbols.record import Record
from dextar_control.symbols.types import Array


class ObserverEstimator(Estimator):
    """``observer``."""

    tells_side = True

    def __init__(
        self,
        model: Model,
        settings: Settings,
        min_type1: float,
        estimate: Record | None = None,
    ) -> None:
        self.observer = Observer(model, min_type1, estimate)
        self._joints = JointFilter(model.mechanism)
        super().__init__(model, settings, min_type1, self.observer.estimate)

    def configure(self, settings: Settings) -> None:
        """See ``Estimator``."""
        noise, test = self.observer.noise, self.observer.test_noise
        noise.encoder, noise.bias, noise.bias_walk = (
            settings.observer.encoder_deviation,
            settings.observer.bias_deviation,
            settings.observer.bias_walk,
        )
        noise.torque, noise.acceleration = (
            settings.observer.torque_deviation,
            settings.observer.acceleration_deviation,
        )
        noise.scatter_gain = settings.observer.scatter_gain
        noise.disturbance, noise.disturbance_walk = (
            settings.observer.disturbance_deviation,
            settings.observer.disturbance_walk,
        )
        noise.shock_gate, noise.shock_speed = (
            settings.observer.impact_gate**2,
            settings.observer.impact_speed,
        )
        allowed = (
            test.disturbance,
            test.disturbance_turn,
            test.disturbance_walk,
        )  # of a test that may be going on
        worse = (
            test.encoder / self.observer.test_encoder
            if self.observer.test_encoder
            else 1.0
        )
        test.take(noise)
        test.disturbance, test.disturbance_turn, test.disturbance_walk = allowed
        test.encoder = settings.crossing_test.encoder_deviation * worse
        self.observer.test_encoder = settings.crossing_test.encoder_deviation
        test.torque, test.bias = (
            settings.crossing_test.torque_deviation,
            settings.crossing_test.bias_deviation,
        )
        test.acceleration = settings.crossing_test.acceleration_deviation
        self.observer.most_lacking = settings.crossing_test.max_disturbance
        self.observer.passage = Passage(
            settings.crossing_test.unknown_below_abs_s,
            settings.crossing_test.begin_below_abs_s,
            settings.crossing_test.log_odds,
        )
        self.unknown_s = settings.crossing_test.unknown_below_abs_s
        self._sure, self._bandwidth = (
            settings.mode_check.confidence,
            settings.joint_filter.bandwidth,
        )

    @property
    def mode_known(self) -> bool:
        """See ``Estimator``."""
        return bool(self.estimate.confidence >= self._sure)

    @property
    def swaps(self) -> int:
        """How often the test has found the robot on the other side than believed."""
        return sum(side.belief.swaps for side in self.observer.sides)

    @property
    def modes(self) -> list[tuple[float, float]]:
        """See ``Estimator``."""
        return self.observer.modes

    @property
    def bias(self) -> Array:
        """b (n,), rad: the joint angles that the model's geometry does not explain."""
        return np.array(self.observer.main.b)

    def start(self, x: Array, q_a: Array, assembly_mode: int) -> None:
        """See ``Estimator``."""
        self._begin(x, q_a, assembly_mode, REST_SPEED)

    def _begin(self, x: Array, q_a: Array, assembly_mode: int, speed: float) -> None:
        self.observer.begin(x, speed)
        self._joints.set(q_a, 0.0)
        for side in self.observer.sides:
            side.belief = Belief(mode=float(assembly_mode), log_odds=CERTAIN)
        self.observer.tell_side()

    def tell_mode(self, assembly_mode: int, q_a: Array) -> None:
        """See ``Estimator``."""
        self._begin(
            self.observer.direct_model(q_a, assembly_mode),
            q_a,
            assembly_mode,
            self.observer.noise.shock_speed,
        )

    def release(self, crossing: bool) -> None:
        """See ``Estimator``."""
        self._joints.set(self.estimate.q_a, self.estimate.q_a_dot)

    def observe(self, dt: float, q_a: Array, tau: Array) -> None:
        """See ``Estimator``."""
        if self.observer.observe(tau, dt, q_a):
            self.observer.tell_side()

    def track(
        self,
        dt: float,
        q_a: Array,
        tau: Array,
        reference: Record,
        zone: float,
        width: float,
    ) -> None:
        """See ``Estimator``."""
        self.observe(dt, q_a, tau)

    def coast(self, dt: float, q_a: Array, tau: Array) -> None:
        """See ``Estimator``: what brakes are the joints themselves, wherever the
        platform is thought to be.
        """
        self.observe(dt, q_a, tau)
        self._joints.take(q_a, dt, self._bandwidth)
        self.estimate.q_a, self.estimate.q_a_dot = (
            self._joints.memory.q,
            self._joints.memory.q_dot,
        )
