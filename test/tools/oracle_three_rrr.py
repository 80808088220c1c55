"""The planar 3-RRR by an independent rigid-body engine (pinocchio) and a KKT system:
the tests' oracle.

Three open chains of two revolute joints and a free platform; the loop closures enter as
acceleration constraints between the chains' tips and the platform's corners. Nothing
here comes from ``dextar_control.model`` or ``dextar_control.mechanisms``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pin = pytest.importorskip(
    "pinocchio", reason="pin needs numpy 2, which a Jazzy installation does not go with"
)

ANGLES = np.pi * (0.5 + 2.0 / 3.0 * np.arange(3))


def _turn(angle: float) -> np.ndarray:
    return np.array([np.cos(angle), np.sin(angle)])


class Oracle:
    """Inverse and forward dynamics in all nine joints; ``flat`` has the robot's numbers
    by dotted names.
    """

    def __init__(self, flat: dict[str, Any]) -> None:
        self.flat = flat
        model = self.model = pin.Model()
        model.gravity.linear = np.array([*flat["gravity"], 0.0])
        self.tips, self.corners = [], []
        for leg in range(3):
            link = {
                key.partition(".")[2]: value
                for key, value in flat.items()
                if key.startswith(f"leg{leg + 1}.")
            }
            base = np.array([*(flat["base_radius"] * _turn(ANGLES[leg])), 0.0])
            motor = model.addJoint(0, pin.JointModelRZ(), pin.SE3(np.eye(3), base), "")
            along = np.array([1.0, 0.0, 0.0])
            elbow = model.addJoint(
                motor,
                pin.JointModelRZ(),
                pin.SE3(np.eye(3), link["proximal_length"] * along),
                "",
            )
            self._link(
                motor,
                link["proximal_mass"],
                link["proximal_center"] * link["proximal_length"],
                link["proximal_inertia"],
            )
            self._link(motor, 0.0, 0.0, link["rotor_inertia"])
            self._link(
                elbow,
                link["distal_mass"],
                link["distal_center"] * link["distal_length"],
                link["distal_inertia"],
            )
            self.tips.append(self._frame(elbow, link["distal_length"] * along))
        place = pin.SE3.Identity()
        platform = model.addJoint(
            model.addJoint(
                model.addJoint(0, pin.JointModelPX(), place, ""),
                pin.JointModelPY(),
                place,
                "",
            ),
            pin.JointModelRZ(),
            place,
            "",
        )
        self._link(platform, flat["platform_mass"], 0.0, flat["platform_inertia"])
        self.corners = [
            self._frame(
                platform, np.array([*(flat["platform_radius"] * _turn(angle)), 0.0])
            )
            for angle in ANGLES
        ]
        self.data = model.createData()
        self.scale = np.array(
            [1.0, 1.0, 1.0 / flat["rotation_radius"]]
        )  # from x to the platform's joints

    def _link(self, joint: int, mass: float, center: float, inertia: float) -> None:
        body = pin.Inertia(
            mass, np.array([center, 0.0, 0.0]), np.diag([0.0, 0.0, inertia])
        )
        self.model.appendBodyToJoint(joint, body, pin.SE3.Identity())

    def _frame(self, joint: int, place: np.ndarray) -> int:
        return self.model.addFrame(
            pin.Frame(
                f"f{self.model.nframes}",
                joint,
                0,
                pin.SE3(np.eye(3), place),
                pin.FrameType.OP_FRAME,
            )
        )

    def _joints(
        self, q_a: np.ndarray, x: np.ndarray, x_dot: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """All joints (9,) of a closed configuration, by plain geometry, and their
        velocities, by the constraints.
        """
        q = np.zeros(9)
        q[6:] = self.scale * x
        for leg in range(3):
            elbow = self.flat["base_radius"] * _turn(ANGLES[leg]) + self.flat[
                f"leg{leg + 1}.proximal_length"
            ] * _turn(q_a[leg])
            corner = x[:2] + self.flat["platform_radius"] * _turn(ANGLES[leg] + q[8])
            q[2 * leg] = q_a[leg]
            q[2 * leg + 1] = np.arctan2(*(corner - elbow)[::-1]) - q_a[leg]
        jacobian, _ = self._constraint(q, np.zeros(9))
        v = np.zeros(9)
        v[6:] = self.scale * x_dot
        v[:6] = np.linalg.solve(jacobian[:, :6], -jacobian[:, 6:] @ v[6:])
        return q, v

    def _constraint(
        self, q: np.ndarray, v: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """(6, 9) Jacobian of tips less corners, and its rate times v (6,)."""
        frame = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        pin.computeJointJacobians(self.model, self.data, q)
        pin.forwardKinematics(self.model, self.data, q, v, np.zeros(9))
        pin.updateFramePlacements(self.model, self.data)

        def jacobian(name: int) -> np.ndarray:
            return np.array(pin.getFrameJacobian(self.model, self.data, name, frame))[
                :2
            ]

        def drift(name: int) -> np.ndarray:
            return np.array(
                pin.getFrameClassicalAcceleration(
                    self.model, self.data, name, frame
                ).linear
            )[:2]

        pairs = list(zip(self.tips, self.corners, strict=True))
        return (
            np.vstack([jacobian(tip) - jacobian(corner) for tip, corner in pairs]),
            np.concatenate([drift(tip) - drift(corner) for tip, corner in pairs]),
        )

    def _terms(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        mass = np.array(pin.crba(self.model, self.data, q))
        mass = np.triu(mass) + np.triu(mass, 1).T
        return mass, np.array(pin.nonLinearEffects(self.model, self.data, q, v))

    def forward(
        self, q_a: np.ndarray, x: np.ndarray, x_dot: np.ndarray, tau: np.ndarray
    ) -> np.ndarray:
        """Platform acceleration (3,) under input torques (3,)."""
        q, v = self._joints(q_a, x, x_dot)
        mass, bias = self._terms(q, v)
        jacobian, drift = self._constraint(q, v)
        matrix = np.block([[mass, -jacobian.T], [jacobian, np.zeros((6, 6))]])
        torque = np.zeros(9)
        torque[0:6:2] = tau
        return (
            np.linalg.solve(matrix, np.concatenate([torque - bias, -drift]))[6:9]
            / self.scale
        )

    def inverse(
        self, q_a: np.ndarray, x: np.ndarray, x_dot: np.ndarray, x_ddot: np.ndarray
    ) -> np.ndarray:
        """Input torques (3,) for a platform acceleration (3,), off the Type 2 locus."""
        q, v = self._joints(q_a, x, x_dot)
        mass, bias = self._terms(q, v)
        jacobian, drift = self._constraint(q, v)
        a = np.zeros(9)
        a[6:] = self.scale * x_ddot
        a[:6] = np.linalg.solve(jacobian[:, :6], -drift - jacobian[:, 6:] @ a[6:])
        selection = np.zeros((9, 3))
        selection[[0, 2, 4], range(3)] = 1.0
        return np.linalg.solve(np.hstack([selection, jacobian.T]), mass @ a + bias)[:3]
