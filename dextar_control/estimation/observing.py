"""The estimator ``observer``: it gives what the observer's main filter believes."""

from __future__ import annotations

import numpy as np

from dextar_control.contract.settings import Settings
from dextar_control.estimation.belief import CERTAIN, Belief
from dextar_control.estimation.estimate import Estimator
from dextar_control.estimation.joint_filter import JointFilter
from dextar_control.estimation.observer import REST_SPEED, Observer
from dextar_control.model.model import Model
from dextar_control.symbols.record import Record
from dextar_control.symbols.types import Array


class ObserverEstimator(Estimator):
    """The estimator ``observer``."""

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
        told, test_told = settings.observer, settings.crossing_test
        now = noise.layout.make(
            encoder=told.encoder_deviation,
            scatter_gain=told.scatter_gain,
            bias=told.bias_deviation,
            bias_walk=told.bias_walk,
            torque=told.torque_deviation,
            acceleration=told.acceleration_deviation,
            disturbance=told.disturbance_deviation,
            disturbance_walk=told.disturbance_walk,
            shock_gate=told.impact_gate**2,
            shock_speed=told.impact_speed,
        )
        noise.take(now)
        # of a test that may be going on:
        allowed = test.disturbance, test.disturbance_turn, test.disturbance_walk
        before = self.observer.crossing_test.encoder_deviation
        worse = test.encoder / before if before else 1.0
        test.take(noise)
        test.disturbance, test.disturbance_turn, test.disturbance_walk = allowed
        test.encoder = test_told.encoder_deviation * worse
        test.torque = test_told.torque_deviation
        test.bias = test_told.bias_deviation
        test.acceleration = test_told.acceleration_deviation
        self.observer.crossing_test = test_told
        self.unknown_s = test_told.unknown_below_abs_s
        self._sure = settings.mode_check.confidence
        self._bandwidth = settings.joint_filter.bandwidth

    @property
    def mode_known(self) -> bool:
        """See ``Estimator``."""
        return bool(self.estimate.confidence >= self._sure)

    @property
    def swaps(self) -> int:
        """The number of times that the test has found the robot on the other side."""
        return sum(side.belief.swaps for side in self.observer.sides)

    @property
    def modes(self) -> list[tuple[float, float]]:
        """See ``Estimator``."""
        return self.observer.modes

    @property
    def bias(self) -> Array:
        """b (n,), rad: the error of the joints by a wrong geometry, as estimated."""
        return np.array(self.observer.main.b)

    def start(self, x: Array, q_a: Array, assembly_mode: int) -> None:
        """See ``Estimator``: x (n,), m, q_a (n,), rad."""
        self._begin(x, q_a, assembly_mode, REST_SPEED)

    def _begin(self, x: Array, q_a: Array, assembly_mode: int, speed: float) -> None:
        self.observer.begin(x, speed)
        self._joints.set(q_a, 0.0)
        for side in self.observer.sides:
            side.belief = Belief(mode=float(assembly_mode), log_odds=CERTAIN)
        self.observer.tell_side()

    def tell_mode(self, assembly_mode: int, q_a: Array) -> None:
        """See ``Estimator``: q_a (n,), rad."""
        x = self.observer.direct_model(q_a, assembly_mode)
        self._begin(x, q_a, assembly_mode, self.observer.noise.shock_speed)

    def release(self, crossing: bool) -> None:
        """See ``Estimator``."""
        self._joints.set(self.estimate.q_a, self.estimate.q_a_dot)

    def observe(self, dt: float, q_a: Array, tau: Array) -> None:
        """Take the measured joints q_a (n,), rad, and the torques tau (n,), N m, that
        acted for dt, s.
        """
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
        """See ``Estimator``: q_a (n,), rad, tau (n,), N m."""
        self.observe(dt, q_a, tau)

    def coast(self, dt: float, q_a: Array, tau: Array) -> None:
        """See ``Estimator``: q_a (n,), rad, tau (n,), N m. The estimate has the joints
        as they are measured, which a brake acts on, and not those of its platform.
        """
        self.observe(dt, q_a, tau)
        self._joints.take(q_a, dt, self._bandwidth)
        self.estimate.q_a = self._joints.memory.q
        self.estimate.q_a_dot = self._joints.memory.q_dot
