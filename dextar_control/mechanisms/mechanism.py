"""What a mechanism is: names, parameters, loop closures, a Lagrangian and geometric
models, on CasADi's symbols.

All else (Eqs. 1-14 of the paper, forward dynamics, derivatives) follows from these by
differentiation, in ``model.equations``.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np

from dextar_control.contract.errors import ParameterError
from dextar_control.mechanisms.bodies import Bodies
from dextar_control.symbols.types import Array, Symbol

LEAST_SQUARE = 1e-12  # of a sine at Type 1, whose root has a derivative


@dataclass(frozen=True)
class Coordinate:
    """An active joint or a coordinate of the platform.

    Attributes:
        name: as topics and files spell it.
        unit: of its position.
    """

    name: str
    unit: str

    @property
    def effort_unit(self) -> str:
        """Of what drives it."""
        return "N" if self.unit == "m" else "N m"


@dataclass(frozen=True)
class Parameter:
    """A number, or some, that the equations take.

    Attributes:
        name: dotted, as in the robot's file.
        unit: SI.
        meaning: in a few words.
        minimum, maximum: inclusive bounds.
        above: exclusive lower bound.
        size: how many numbers.
    """

    name: str
    unit: str
    meaning: str
    minimum: float = -math.inf
    maximum: float = math.inf
    above: float = -math.inf
    size: int = 1

    def check(self, value: Any) -> list[float]:
        """The numbers of a value.

        Raises:
            ParameterError: they are not ``size`` finite numbers within the bounds.
        """
        numbers = (
            list(value) if isinstance(value, (list, tuple, np.ndarray)) else [value]
        )
        kinds = (int, float, np.number)
        if len(numbers) != self.size or not all(
            isinstance(n, kinds) and not isinstance(n, bool) and math.isfinite(n)
            for n in numbers
        ):
            raise ParameterError(
                f"robot.{self.name} = {value!r}; it must be {self.size} finite"
                f" number{'s' * (self.size > 1)}"
            )
        for number in numbers:
            if number <= self.above:
                raise ParameterError(
                    f"robot.{self.name} = {value}; it must be > {self.above:g}"
                    f" {self.unit}"
                )
            if not self.minimum <= number <= self.maximum:
                raise ParameterError(
                    f"robot.{self.name} = {value}; it must lie in [{self.minimum:g},"
                    f" {self.maximum:g}] {self.unit}"
                )
        return [float(number) for number in numbers]


class Mechanism(ABC):
    """A parallel mechanism with as many active joints as platform coordinates, n.

    The platform's coordinates share one unit (an angle is given as a length, times a
    radius), so that singular values of A_r and norms of wrenches have a meaning.

    Attributes:
        name: of the mechanism.
        joints: the active ones, q_a (n).
        coordinates: of the platform, x (n).
        parameters: what the methods find in ``p``, by their dotted names.
    """

    name: str
    joints: tuple[Coordinate, ...]
    coordinates: tuple[Coordinate, ...]
    parameters: tuple[Parameter, ...]

    @property
    def n(self) -> int:
        """Degrees of freedom."""
        return len(self.joints)

    @abstractmethod
    def closures(self, q_a: Symbol, x: Symbol, p: Any) -> Symbol:
        """h(q_a, x) (n,): zero where the loops are closed."""

    @abstractmethod
    def lagrangian(
        self, q_a: Symbol, x: Symbol, q_a_dot: Symbol, x_dot: Symbol, p: Any
    ) -> Symbol:
        """L(q_a, x, q_a_dot, x_dot), J: kinetic less potential energy."""

    def inverse_geometric_model(self, x: Symbol, p: Any) -> Symbol:
        """q_a (n,) of a platform position in the working mode of ``p``; nan where it is
        not reached. Here, those of ``nearest_joints``.
        """
        q_a, extension = self.nearest_joints(x, p)
        return ca.if_else(ca.fabs(extension) <= 1.0, q_a, ca.SX.nan(self.n))

    def nearest_joints(self, x: Symbol, p: Any) -> tuple[Symbol, Symbol]:
        """(q_a (n,), extension (n,)): the inverse geometric model with finite numbers
        and derivatives everywhere.

        The extension of a leg is within [-1, 1] where it reaches x, +-1 at Type 1 and
        beyond that by how far it misses; there the joint is the one that comes nearest.
        What optimises needs it; a mechanism for which nothing is planned does without.
        """
        raise ParameterError(
            f"mechanism {self.name} has no nearest_joints, which planning needs: write"
            " that method"
        )

    def unreached(self, x: Array, q_a: Array, p: Any) -> str:
        """Why q_a is nan at x, in words; ``p`` has numbers."""
        joint = self.joints[int(np.argmin(np.isfinite(q_a)))].name
        return (
            f"x = {np.round(x, 6).tolist()} is out of reach: {joint} has no angle there"
        )

    def direct_geometric_model(
        self, q_a: Symbol, assembly_mode: Symbol, p: Any
    ) -> Symbol | None:
        """x (n,) of joint positions with sign(s) = assembly_mode, its root kept above
        zero; None, as here, where it has no closed form and is solved.

        Where A_r has k blocks the assembly mode has a sign for each (k,), or one for
        all.
        """
        return None

    def type2_locus(
        self, family: Symbol, branch: Symbol, angle: Symbol, p: Any
    ) -> tuple[Symbol, Symbol, Symbol] | None:
        """(q_a (n,), x (n,), closing) of the Type 2 locus at a tracing angle; None
        where it is not traced in closed form.

        Of a mechanism without, a place of the locus is found near a given one, and
        planned for as it stands.
        """
        return None

    def family_name(self, A_r: Array) -> str:
        """Which family of the locus a place of it belongs to, by A_r (n, n); "" where
        there is one.
        """
        return ""

    def length(self, p: Any) -> float:
        """By which distances are measured, m; ``p`` has numbers."""
        return float(np.ravel(self.singularity_length(p))[0])

    def mirror_image(self, q_a: Symbol, x: Symbol, p: Any) -> Symbol | None:
        """The other place (n,) of the platform that the joints q_a leave, with
        -sign(s); None where it has no closed form.
        """
        return None

    def why_open(self, q_a: Array, p: Any) -> str:
        """Why no place of the platform closes the loops at joints q_a (n,), in words;
        "" where one does or that is not known.

        ``p`` has numbers.
        """
        return ""

    def folded(self, q_a: Symbol, x: Symbol, p: Any) -> Symbol:
        """Positive where that other place is far away even near the locus, so that
        joints that fit one do not fit the other.

        Of all, or (k,) of blocks of A_r.
        """
        return ca.SX(-1.0)

    def singularity_of_joints(self, q_a: Symbol, p: Any) -> Symbol | None:
        """|s| from the active joints alone, the same in both assembly modes, 0 where
        they do not close; None where unknown.
        """
        return None

    def linkage(self, q_a: Array, x: Array, p: Any) -> Array:
        """(k, 2) places in the plane, m, whose polygon is drawn as the robot; none
        where there is no picture of it.
        """
        return np.zeros((0, 2))

    def bodies(self, p: Any) -> Bodies | None:
        """What it is built of, for who builds it; None where that is not said, and then
        the next two are not asked.
        """
        return None

    def tree_joints(self, q_a: Symbol, x: Symbol, p: Any) -> Symbol:
        """Positions (m,) of all joints of its bodies, rad or m, where the loops are
        closed.
        """
        raise NotImplementedError

    def tree_platform(self, joints: Symbol, p: Any) -> Symbol:
        """x (n,) of the bodies at positions (m,) of all joints."""
        raise NotImplementedError

    @abstractmethod
    def singularity_scale(self, p: Any) -> Symbol:
        """What det(A_r) is divided by to give s, dimensionless and about 1 far from the
        Type 2 locus; (k,) of blocks of A_r.
        """

    def singularity_length(self, p: Any) -> Symbol:
        """What the least singular value of A_r is divided by to be dimensionless. Here,
        the n-th root of the scale, where A_r has one block.
        """
        return self.singularity_scale(p) ** (1.0 / self.n)

    def type1_sines(self, q_a: Symbol, x: Symbol, p: Any) -> Symbol:
        """One number a leg that is zero where the leg is at a Type 1 singularity, and
        at most 1 in size. Here, by the extensions of ``nearest_joints``.
        """
        _, extension = self.nearest_joints(x, p)
        return ca.sqrt(ca.fmax(1.0 - extension**2, LEAST_SQUARE))

    def friction(self, q_a_dot: Symbol, p: Any) -> Symbol:
        """Friction torque of the active joints (n,), N m (N), opposing q_a_dot; none
        here.
        """
        return ca.SX.zeros(self.n)

    def passive_friction(
        self, q_a: Symbol, x: Symbol, q_a_dot: Symbol, x_dot: Symbol, p: Any
    ) -> tuple[Symbol, Symbol]:
        """(rates (k,), rad/s, of joints without a motor, friction torques (k,), N m,
        that oppose them); none where there is none.

        The rates depend on both velocities as if they were independent, as the
        Lagrangian does.
        """
        return ca.SX(0, 1), ca.SX(0, 1)

    def transmission(self, p: Any) -> tuple[Symbol, Symbol, Symbol] | None:
        """(rotor inertia, kg m^2, stiffness, N m/rad, 0 where rigid, damping, N m
        s/rad), (n,) each, between motors and joints.

        None where all are rigid.
        """
        return None

    def symbols(self) -> tuple[Symbol, Any]:
        """(all parameters as one vector, the same by their dotted names)."""
        vector = ca.SX.sym("p", sum(parameter.size for parameter in self.parameters))
        return vector, self.named(vector)

    def rows_of(self, name: str) -> slice | None:
        """Where a parameter stands in the vector; None where there is none of that
        name.
        """
        place = 0
        for parameter in self.parameters:
            if parameter.name == name:
                return slice(place, place + parameter.size)
            place += parameter.size
        return None

    def named(self, vector: Any) -> Any:
        """The parameters of a vector of symbols or numbers by their dotted names."""
        named, place = SimpleNamespace(), 0
        for parameter in self.parameters:
            *groups, last = parameter.name.split(".")
            owner = named
            for group in groups:
                if not hasattr(owner, group):
                    setattr(owner, group, SimpleNamespace())
                owner = getattr(owner, group)
            setattr(owner, last, vector[place : place + parameter.size])
            place += parameter.size
        return named

    def values(self, flat: Mapping[str, Any]) -> Array:
        """The vector of ``symbols`` for dotted names and values; others' keys are
        ignored.

        Raises:
            ParameterError: one is missing or out of its bounds.
        """
        missing = [
            parameter.name
            for parameter in self.parameters
            if parameter.name not in flat
        ]
        if missing:
            raise ParameterError(
                f"robot parameter '{missing[0]}' of the mechanism {self.name} is"
                " missing"
            )
        return np.array(
            [
                number
                for parameter in self.parameters
                for number in parameter.check(flat[parameter.name])
            ]
        )
