"""The records of reference and estimate at one sample."""

from __future__ import annotations

from dextar_control.symbols.record import Field

REFERENCE = (
    Field("x", "m", "platform", "n"),
    Field("x_dot", "m/s", "its velocity", "n"),
    Field("x_ddot", "m/s^2", "its acceleration", "n"),
    Field("q_a", "rad", "active joints", "n"),
    Field("q_a_dot", "rad/s", "their velocities", "n"),
    Field("multipliers", "N/m", "lambda of the plan, finite on the locus", "n"),
    Field("s", "1", "singularity measure"),
)
ESTIMATE = (
    Field("x", "m", "platform", "n"),
    Field("x_dot", "m/s", "its velocity", "n"),
    Field("q_a", "rad", "active joints", "n"),
    Field("q_a_dot", "rad/s", "their velocities", "n"),
    Field("assembly_mode", "1", "believed sign of s"),
    Field("confidence", "1", "in the assembly mode, 0.5 to 1"),
    Field("s", "1", "singularity measure"),
    Field("d", "N m", "torques on the joints that are not modelled", "n"),
    Field("b", "rad", "error of the joints by a wrong geometry", "n"),
    Field("twist_dot", "rad/s", "of the transmissions: motors less joints", "n"),
    Field("innovation", "rad", "of the sample: measured less predicted joints", "n"),
    Field("innovation_square", "1", "normalised: n on average in a consistent filter"),
)
