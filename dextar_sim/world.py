"""A mechanism's bodies in a PyBullet client: a tree of joints whose loops constraints
close.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import NamedTuple

import pybullet as p

from dextar_control.contract.errors import ParameterError
from dextar_control.mechanisms.bodies import Bodies
from dextar_sim.urdf import point, urdf

_SPEED_CLAMP = 1.0e6
_ITERATIONS = 200
# Squared impulse change at which the solver stops: over a crossing within 2 nm of
# 1e-22, in four fifths of the time.
_RESIDUAL = 1.0e-10
# Share of the loop gap corrected in one substep; leaves a quarter of the gap of
# PyBullet's default.
_ERP = 0.8


_KEPT = 4
# Connections without a window that no plant uses: making one takes 15 ms, emptying one
# 0.3 ms.
_idle: list[int] = []


def connect(window: bool) -> int:
    """Return a connection to PyBullet with an empty world.

    Nothing collides here, and the simple broadphase finds that out sooner.

    Args:
        window: open PyBullet's own window.

    Raises:
        ParameterError: PyBullet refuses.
    """
    if _idle and not window:
        return _idle.pop()
    client = int(p.connect(p.GUI if window else p.DIRECT))
    if client < 0:
        raise ParameterError(
            "PyBullet refused a connection" + (" with a window" if window else "")
        )
    clear(client)
    return client


def clear(client: int) -> None:
    """Empty a connection."""
    p.resetSimulation(p.RESET_USE_SIMPLE_BROADPHASE, physicsClientId=client)


def release(client: int, window: bool) -> None:
    """Empty a connection and keep it for the next plant, or leave it."""
    if not p.isConnected(client):
        return
    if window or len(_idle) >= _KEPT:
        p.disconnect(client)
    else:
        clear(client)
        _idle.append(client)


class Loop(NamedTuple):
    """Where the bodies of a mechanism are in their client.

    Attributes:
        body: unique id of the tree.
        joints: indices of the joints in the order of the bodies, which are also those
            of the links they move.
    """

    body: int
    joints: list[int]


def load(client: int, bodies: Bodies, substep: float, window: bool) -> Loop:
    """Load the tree without motors, damping or speed limit, and a constraint for each
    pin.

    PyBullet keeps URDF text by path, so each plant has a path of its own. The
    constraint's pivots are measured from the centres of mass.

    Args:
        client: PyBullet's connection.
        bodies: with numbers.
        substep: duration of one physics step, s.
        window: draw the links.
    """
    descriptor, path = tempfile.mkstemp(suffix=".urdf", prefix="bodies_")
    try:
        with os.fdopen(descriptor, "w", encoding="utf-8") as file:
            file.write(urdf("robot", bodies, visual=window))
        body = p.loadURDF(
            path,
            useFixedBase=True,
            flags=p.URDF_USE_INERTIA_FROM_FILE,
            physicsClientId=client,
        )
    finally:
        Path(path).unlink()
    found = {
        p.getJointInfo(body, index, physicsClientId=client)[1].decode(): index
        for index in range(p.getNumJoints(body, physicsClientId=client))
    }
    joints = [found[link.joint] for link in bodies.links]
    for link in (-1, *joints):
        p.changeDynamics(
            body,
            link,
            linearDamping=0.0,
            angularDamping=0.0,
            jointDamping=0.0,
            maxJointVelocity=_SPEED_CLAMP,
            physicsClientId=client,
        )
    p.setJointMotorControlArray(
        body,
        joints,
        p.VELOCITY_CONTROL,
        forces=[0.0] * len(joints),
        physicsClientId=client,
    )
    p.setGravity(*point(bodies.gravity), 0.0, physicsClientId=client)
    p.setPhysicsEngineParameter(
        numSolverIterations=_ITERATIONS,
        erp=_ERP,
        solverResidualThreshold=_RESIDUAL,
        physicsClientId=client,
    )
    set_step(client, substep)
    for (one, other), (here, there) in bodies.pins:
        pivots = [
            [*point(place - bodies.links[link].center), 0.0]
            for link, place in ((one, here), (other, there))
        ]
        p.createConstraint(
            body,
            joints[one],
            body,
            joints[other],
            p.JOINT_POINT2POINT,
            [0.0] * 3,
            *pivots,
            physicsClientId=client,
        )
    if window:
        p.configureDebugVisualizer(p.COV_ENABLE_GUI, 0, physicsClientId=client)
        p.resetDebugVisualizerCamera(
            0.35, 0.0, -89.9, [0.0, 0.05, 0.0], physicsClientId=client
        )
    return Loop(body, joints)


def set_step(client: int, duration: float, parts: int = 0) -> None:
    """Let one ``stepSimulation`` advance a duration (s), in that many equal parts where
    there are any.
    """
    p.setPhysicsEngineParameter(
        fixedTimeStep=duration, numSubSteps=parts, physicsClientId=client
    )
