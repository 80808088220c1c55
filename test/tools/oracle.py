"""The five-bar by an independent rigid-body engine (pinocchio) and a KKT system: the
tests' oracle.

Two open chains of two revolute joints; the loop closure enters as an acceleration
constraint on the two tips. Nothing here comes from ``dextar_control.model`` or
``dextar_control.mechanisms``.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from dextar_control.contract.robot import RobotParameters

pin = pytest.importorskip(
    "pinocchio", reason="pin needs numpy 2, which a Jazzy installation does not go with"
)


class Oracle:
    """Inverse and forward dynamics in all four joints."""

    def __init__(self, robot: RobotParameters) -> None:
        self.robot = robot
        self.model = pin.Model()
        self.model.gravity.linear = np.array([*robot.gravity, 0.0])
        self.tips = []
        for leg, base in zip(
            robot.legs,
            (-0.5 * robot.base_distance, 0.5 * robot.base_distance),
            strict=True,
        ):
            motor = self.model.addJoint(
                0,
                pin.JointModelRZ(),
                pin.SE3(np.eye(3), np.array([base, 0.0, 0.0])),
                "",
            )
            elbow = self.model.addJoint(
                motor,
                pin.JointModelRZ(),
                pin.SE3(np.eye(3), np.array([leg.proximal_length, 0.0, 0.0])),
                "",
            )
            self._link(
                motor,
                leg.proximal_mass,
                leg.proximal_center * leg.proximal_length,
                leg.proximal_inertia,
            )
            self._link(
                elbow,
                leg.distal_mass,
                leg.distal_center * leg.distal_length,
                leg.distal_inertia,
            )
            tip = pin.SE3(np.eye(3), np.array([leg.distal_length, 0.0, 0.0]))
            self.tips.append(
                self.model.addFrame(
                    pin.Frame(f"tip{elbow}", elbow, 0, tip, pin.FrameType.OP_FRAME)
                )
            )
            self._link(motor, 0.0, 0.0, leg.rotor_inertia)
        last = self.model.njoints - 1
        length = robot.right.distal_length
        self._link(last, robot.end_effector_mass, length, 0.0)
        self.data = self.model.createData()

    def _link(self, joint: int, mass: float, center: float, inertia: float) -> None:
        body = pin.Inertia(
            mass, np.array([center, 0.0, 0.0]), np.diag([0.0, 0.0, inertia])
        )
        self.model.appendBodyToJoint(joint, body, pin.SE3.Identity())

    def joints(
        self, q_a: np.ndarray, x: np.ndarray, x_dot: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """All joints and their velocities (4,) of a closed configuration, by plain
        geometry.
        """
        q, v = np.zeros(4), np.zeros(4)
        for i, (leg, base) in enumerate(zip(self.robot.legs, (-0.5, 0.5), strict=True)):
            u = np.array([np.cos(q_a[i]), np.sin(q_a[i])])
            n = np.array([-u[1], u[0]])
            r = (
                x
                - np.array([base * self.robot.base_distance, 0.0])
                - leg.proximal_length * u
            )
            rate = r @ x_dot / (leg.proximal_length * (r @ n))
            slip = x_dot - leg.proximal_length * n * rate
            q[2 * i], v[2 * i] = q_a[i], rate
            q[2 * i + 1] = np.arctan2(r[1], r[0]) - q_a[i]
            v[2 * i + 1] = (r[0] * slip[1] - r[1] * slip[0]) / (r @ r) - rate
        return q, v

    def constraint_dynamics(
        self, q_a: np.ndarray, x: np.ndarray
    ) -> Callable[[], object]:
        """One call of pinocchio's own solver at rest, without torque: what a tick's
        time is measured by.
        """
        model = pin.Model(self.model)
        ends = [
            pin.SE3(np.eye(3), np.array([leg.distal_length, 0.0, 0.0]))
            for leg in self.robot.legs
        ]
        contacts = pin.StdVec_RigidConstraintModel()
        contacts.append(
            pin.RigidConstraintModel(
                pin.ContactType.CONTACT_3D,
                model,
                2,
                ends[0],
                4,
                ends[1],
                pin.ReferenceFrame.LOCAL,
            )
        )
        found = pin.StdVec_RigidConstraintData()
        found.append(contacts[0].createData())
        data, proximal = model.createData(), pin.ProximalSettings(1e-9, 1e-9, 5)
        pin.initConstraintDynamics(model, data, contacts, found)
        q, v = self.joints(q_a, x, np.zeros(2))
        tau = np.zeros(4)
        return lambda: pin.constraintDynamics(
            model, data, q, v, tau, contacts, found, proximal
        )

    def _terms(
        self, q: np.ndarray, v: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, list[np.ndarray], list[np.ndarray]]:
        pin.computeAllTerms(self.model, self.data, q, v)
        pin.forwardKinematics(self.model, self.data, q, v, np.zeros(4))
        pin.updateFramePlacements(self.model, self.data)
        mass = np.array(pin.crba(self.model, self.data, q))
        mass = np.triu(mass) + np.triu(mass, 1).T
        bias = np.array(pin.nonLinearEffects(self.model, self.data, q, v))
        frame = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        pin.computeJointJacobians(self.model, self.data, q)
        jacobians = [
            np.array(pin.getFrameJacobian(self.model, self.data, tip, frame))[:2]
            for tip in self.tips
        ]
        pin.forwardKinematics(self.model, self.data, q, v, np.zeros(4))
        drifts = [
            np.array(
                pin.getFrameClassicalAcceleration(
                    self.model, self.data, tip, frame
                ).linear
            )[:2]
            for tip in self.tips
        ]
        return mass, bias, jacobians, drifts

    def forward(
        self, q_a: np.ndarray, x: np.ndarray, x_dot: np.ndarray, tau: np.ndarray
    ) -> np.ndarray:
        """Platform acceleration (2,) under input torques (2,)."""
        q, v = self.joints(q_a, x, x_dot)
        mass, bias, (left, right), (left_drift, right_drift) = self._terms(q, v)
        closure = left - right
        matrix = np.block([[mass, -closure.T], [closure, np.zeros((2, 2))]])
        torque = np.array([tau[0], 0.0, tau[1], 0.0])
        solution = np.linalg.solve(
            matrix, np.concatenate([torque - bias, right_drift - left_drift])
        )
        return left @ solution[:4] + left_drift

    def inverse(
        self, q_a: np.ndarray, x: np.ndarray, x_dot: np.ndarray, x_ddot: np.ndarray
    ) -> np.ndarray:
        """Input torques (2,) for a platform acceleration (2,), off the Type 2 locus."""
        q, v = self.joints(q_a, x, x_dot)
        mass, bias, (left, right), (left_drift, right_drift) = self._terms(q, v)
        tips = np.vstack([left, right])
        a = np.linalg.solve(
            tips, np.concatenate([x_ddot - left_drift, x_ddot - right_drift])
        )
        selection = np.zeros((4, 2))
        selection[0, 0] = selection[2, 1] = 1.0
        unknown = np.hstack([selection, (left - right).T])
        return np.linalg.solve(unknown, mass @ a + bias)[:2]
