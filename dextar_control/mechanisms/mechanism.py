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
from itertools import accumulate

import casadi as ca
import numpy as np

from dextar_control.contract.errors import ParameterError
from dextar_control.mechanisms.bodies import Bodies
from dextar_control.symbols.types import Array, Slice, Symbol

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
        """The unit of the force or torque that drives it."""
        return "N" if self.unit == "m" else "N m"


@dataclass(frozen=True)
class Constant:
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

    def check(self, value: object) -> list[float]:
        """Return the numbers of a value.

        Raises:
            ParameterError: they are not ``size`` finite numbers within the bounds.
        """
        numbers = (
            list(value) if isinstance(value, (list, tuple, np.ndarray)) else [value]
        )
        finite = [
            float(number)
            for number in numbers
            if isinstance(number, (int, float, np.integer, np.floating))
            and not isinstance(number, bool)
            and math.isfinite(number)
        ]
        if not len(finite) == len(numbers) == self.size:
            raise ParameterError(
                f"robot.{self.name} = {value!r}; it must be {self.size} finite"
                f" number{'s' * (self.size > 1)}"
            )
        for number in finite:
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
        return finite


class Values:
    """Parameters by name: symbols, or numbers, on which the same expressions work.

    A parameter without a dot is an attribute, ``p.gravity``; those that share what
    stands before the dot are reached by it, ``p["left"].distal_length``.

    Args:
        values: parameters, or groups of them, by name.
    """

    def __init__(self, **values: Symbol | Array | Values) -> None:
        self.__dict__.update(values)

    def __getattr__(self, name: str) -> Symbol:
        raise AttributeError(f"there is no parameter '{name}' among {[*vars(self)]}")

    def __getitem__(self, group: str) -> Values:
        values: Values = getattr(self, group)
        return values


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
    parameters: tuple[Constant, ...]

    @property
    def n(self) -> int:
        """Degrees of freedom."""
        return len(self.joints)

    @abstractmethod
    def closures(self, q_a: Symbol, x: Symbol, p: Values) -> Symbol:
        """Return h(q_a, x), (n,): zero where the loops are closed."""

    @abstractmethod
    def lagrangian(
        self, q_a: Symbol, x: Symbol, q_a_dot: Symbol, x_dot: Symbol, p: Values
    ) -> Symbol:
        """Return L(q_a, x, q_a_dot, x_dot), J: kinetic less potential energy."""

    def inverse_geometric_model(self, x: Symbol, p: Values) -> Symbol:
        """Return q_a (n,) of a platform position x (n,) in the working mode of ``p``;
        nan where it is not reached. Here it follows from ``nearest_joints``.
        """
        q_a, extension = self.nearest_joints(x, p)
        return ca.if_else(ca.fabs(extension) <= 1.0, q_a, ca.SX.nan(self.n))

    def nearest_joints(self, x: Symbol, p: Values) -> tuple[Symbol, Symbol]:
        """Return (q_a (n,), extension (n,)): the inverse geometric model with finite
        numbers and derivatives everywhere, which planning needs.

        The extension of a leg is within [-1, 1] where it reaches x, +-1 at Type 1 and
        beyond that by how far it misses; there the joint is the one that comes nearest.

        Raises:
            ParameterError: the mechanism has none.
        """
        raise ParameterError(
            f"mechanism {self.name} has no nearest_joints, which planning needs: write"
            " that method"
        )

    def unreached(self, x: Array, q_a: Array, p: Values) -> str:
        """Return the sentence that says why q_a (n,), rad or m, is nan at x (n,), m;
        ``p`` has numbers.
        """
        joint = self.joints[int(np.argmin(np.isfinite(q_a)))].name
        return (
            f"x = {np.round(x, 6).tolist()} is out of reach: {joint} has no angle there"
        )

    def direct_geometric_model(
        self, q_a: Symbol, assembly_mode: Symbol, p: Values
    ) -> Symbol | None:
        """Return x (n,) of joints q_a (n,) with sign(s) = assembly_mode, its root kept
        above zero; None, as here, where it has no closed form and is solved.

        Where A_r has k blocks the assembly mode has a sign for each, (k,), or one for
        all.
        """
        return None

    def type2_locus(
        self, family: Symbol, branch: Symbol, angle: Symbol, p: Values
    ) -> tuple[Symbol, Symbol, Symbol] | None:
        """Return (q_a (n,), x (n,), closing) of the Type 2 locus at a tracing angle;
        None where it is not traced in closed form.

        Without it a point of the locus is found near a given place.
        """
        return None

    def family_name(self, A_r: Array) -> str:
        """Return the family of the locus that a point of it belongs to, by A_r (n, n),
        m (the closures' unit over m); "" where there is one family.
        """
        return ""

    def length(self, p: Values) -> float:
        """Return the length by which distances are measured, m; ``p`` has numbers."""
        return float(np.ravel(self.singularity_length(p))[0])

    def mirror_image(self, q_a: Symbol, x: Symbol, p: Values) -> Symbol | None:
        """Return the platform position (n,) with -sign(s) that has the same joints q_a
        as x; None where it has no closed form.
        """
        return None

    def why_open(self, q_a: Array, p: Values) -> str:
        """Return the sentence that says why no platform position closes the loops at
        joints q_a (n,), rad or m; "" where one does or that is not known; ``p`` has
        numbers.
        """
        return ""

    def folded(self, q_a: Symbol, x: Symbol, p: Values) -> Symbol:
        """Return a number that is positive where the ``mirror_image`` is far from x
        even near the locus; of all blocks of A_r, or (k,) of each.
        """
        return ca.SX(-1.0)

    def singularity_of_joints(self, q_a: Symbol, p: Values) -> Symbol | None:
        """Return |s| of the joints q_a (n,), which is the same in both assembly modes,
        0 where they do not close the loops; None where that is not known.
        """
        return None

    def linkage(self, q_a: Array, x: Array, p: Values) -> Array:
        """Return the points (k, 2), m, whose polygon is drawn as the robot at joints
        q_a (n,) and platform position x (n,); none where there is no picture of it.
        """
        return np.zeros((0, 2))

    def bodies(self, p: Values) -> Bodies | None:
        """Return the bodies it is built of; None where that is not said, and then
        neither ``tree_joints`` nor ``tree_platform`` is called.
        """
        return None

    def tree_joints(self, q_a: Symbol, x: Symbol, p: Values) -> Symbol:
        """Return positions (m,) of all joints of its bodies, rad or m, where the loops
        are closed.
        """
        raise NotImplementedError

    def tree_platform(self, joints: Symbol, p: Values) -> Symbol:
        """Return x (n,) of the platform where all joints are at positions (m,)."""
        raise NotImplementedError

    @abstractmethod
    def singularity_scale(self, p: Values) -> Symbol:
        """Return the number, or (k,) for blocks of A_r, over which det(A_r) is s:
        dimensionless and about 1 far from the Type 2 locus.
        """

    def singularity_length(self, p: Values) -> Symbol:
        """Return the number over which the least singular value of A_r is
        dimensionless. Here it is the n-th root of the scale, where A_r has one block.
        """
        return self.singularity_scale(p) ** (1.0 / self.n)

    def type1_sines(self, q_a: Symbol, x: Symbol, p: Values) -> Symbol:
        """Return one number a leg, at most 1 in size: zero where the leg is at a Type 1
        singularity. Here it follows from the extensions of ``nearest_joints``.
        """
        _, extension = self.nearest_joints(x, p)
        return ca.sqrt(ca.fmax(1.0 - extension**2, LEAST_SQUARE))

    def friction(self, q_a_dot: Symbol, p: Values) -> Symbol:
        """Return the friction torque of the active joints (n,), N m (N), opposing
        q_a_dot; none here.
        """
        return ca.SX.zeros(self.n)

    def passive_friction(
        self, q_a: Symbol, x: Symbol, q_a_dot: Symbol, x_dot: Symbol, p: Values
    ) -> tuple[Symbol, Symbol]:
        """Return (rates (k,), rad/s, of joints without a motor, friction torques (k,),
        N m, that oppose them); none where there is none.

        The rates depend on both velocities as if they were independent, as the
        Lagrangian does.
        """
        return ca.SX(0, 1), ca.SX(0, 1)

    def transmission(self, p: Values) -> tuple[Symbol, Symbol, Symbol] | None:
        """Return (rotor inertia, kg m^2, stiffness, N m/rad, 0 where rigid, damping, N
        m s/rad), (n,) each, between motors and joints; None where all are rigid.
        """
        return None

    def symbols(self) -> tuple[Symbol, Values]:
        """Return (all parameters as one vector, the same by their dotted names)."""
        vector = ca.SX.sym("p", sum(parameter.size for parameter in self.parameters))
        return vector, self.named(vector)

    def rows(self) -> dict[str, Slice]:
        """Return the rows of each parameter in the vector of ``symbols``, by
        its name.
        """
        ends = accumulate(parameter.size for parameter in self.parameters)
        return {
            parameter.name: slice(end - parameter.size, end)
            for parameter, end in zip(self.parameters, ends, strict=True)
        }

    def named(self, vector: Symbol | ca.DM | Array) -> Values:
        """Return the parameters of a vector (m,) of symbols, or of numbers in SI units
        (m, kg, N and so on), by their dotted names.
        """
        named = Values()
        for name, rows in self.rows().items():
            *groups, last = name.split(".")
            owner = named
            for group in groups:
                owner = vars(owner).setdefault(group, Values())
            vars(owner)[last] = vector[rows]
        return named

    def values(self, flat: Mapping[str, object]) -> Array:
        """Return the vector (m,) of ``symbols`` with numbers, in SI units (m, kg, N and
        so on).

        Args:
            flat: values by dotted names; other names are ignored.

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
