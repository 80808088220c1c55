"""What a campaign may perturb, and what it may ask of a case: names, meanings, units
and limits.
"""

from __future__ import annotations

import math
from typing import NamedTuple


class Range(NamedTuple):
    """A number's closed interval and its meaning.

    Attributes:
        low, high: of the interval.
        meaning: in words, with the unit.
        measure: of ``summary.Group``, that a bar is for.
        unit: in which a bar is told where that is not the measure's own.
    """

    low: float
    high: float
    meaning: str
    measure: str = ""
    unit: str = ""


PERTURBATIONS = {
    "masses": Range(
        0.0, 0.9, "relative error of every mass and inertia of the true robot"
    ),
    "geometry": Range(
        0.0,
        5e-3,
        "error of each of the eight geometric parameters of the true robot, m",
    ),
    "geometry_signs": Range(0.0, 5e-3, "size of that error, each at a random sign, m"),
    "coulomb": Range(0.0, 1.0, "Coulomb friction at each motor of the true robot, N m"),
    "coulomb_speed": Range(
        0.0,
        10.0,
        "joint speed over which that friction changes sign, rad/s; 0: it sticks",
    ),
    "coulomb_modelled": Range(
        0.0, 2.0, "share of that friction which the controller's model has"
    ),
    "command_delay": Range(0.0, 0.1, "from command to drive, s"),
    "sample_loss": Range(
        0.0, 0.99, "probability that a sample never reaches the controller"
    ),
    "encoder_resolution": Range(0.0, 2.0**32, "counts per revolution; 0 is exact"),
    "jitter": Range(
        0.0, 1.0, "share of the period by which a command arrives late at random"
    ),
    "position_noise": Range(
        0.0, 0.1, "standard deviation of a joint position before quantisation, rad"
    ),
    "bounce": Range(0.0, 1.0, "1: an impulse against the motion at the locus"),
    "blow": Range(
        0.0,
        100.0,
        "force against the motion until the locus, instead of that impulse, N",
    ),
    "blow_duration": Range(0.0, 1.0, "for which it acts, s"),
    "push": Range(
        0.0,
        100.0,
        "force along t_s before the first crossing, to one side or the other, N",
    ),
    "push_duration": Range(0.0, 1.0, "for which it acts, s"),
    "push_before": Range(0.0, 1.0, "from its begin to the planned crossing, s"),
    "push_across": Range(0.0, 1.0, "1: it acts across t_s"),
    "belt": Range(
        0.0,
        1e6,
        "stiffness between rotor and proximal link of the true robot, N m/rad; 0:"
        " rigid",
    ),
    "belt_damping": Range(0.0, 1.0, "damping ratio of rotor and belt"),
    "belt_modelled": Range(0.0, 1.0, "1: the controller's model has the belt"),
    "link_encoder": Range(
        0.0, 1.0, "1: behind a belt or backlash the encoders are at the links"
    ),
    "backlash": Range(0.0, 0.1, "of each transmission, rad"),
    "cogging": Range(0.0, 1.0, "amplitude of each motor's torque over its angle, N m"),
    "cogging_periods": Range(1.0, 1000.0, "of it in one revolution"),
    "drive_lag": Range(0.0, 0.1, "time constant of a torque, s"),
    "torque_step": Range(
        0.0, 1.0, "to whole multiples of which torques are rounded, N m"
    ),
    "passive": Range(
        0.0,
        1.0,
        "Coulomb friction of both elbows and of the pin between the distal links of the"
        " true robot, N m",
    ),
    "passive_modelled": Range(
        0.0, 2.0, "share of that friction which the controller's model has"
    ),
    "calibrated": Range(
        0.0,
        1.0,
        "1: the controller's geometry is that of one recorded tour, by poses where"
        " there are some",
    ),
    "identified": Range(
        0.0,
        1.0,
        "1: the controller's masses, friction and gravity are those of one recorded"
        " exciting motion",
    ),
    "tilt": Range(
        0.0,
        1.6,
        "of the robot's plane against the horizontal, unknown to the controller, any"
        " way round, rad",
    ),
    "payload": Range(
        0.0, 10.0, "mass at the end effector that the controller does not know, kg"
    ),
    "payload_time": Range(0.0, 100.0, "at which it is taken up, s"),
    "eccentricity": Range(
        0.0, 0.1, "amplitude of each encoder's error over a turn, rad"
    ),
    "homing_error": Range(
        0.0, 0.1, "by which each encoder is off, at a random sign, rad"
    ),
    "stamp_error": Range(
        0.0, 5e-4, "up to which the time of each sample is told wrong, at random, s"
    ),
    "pose_rate": Range(0.0, 1000.0, "of the external pose measurement, Hz; 0: none"),
    "pose_delay": Range(0.0, 1.0, "of the external pose measurement, s"),
    "pose_noise": Range(
        0.0, 0.1, "standard deviation of each coordinate of the external pose, m"
    ),
    "pose_dropout": Range(0.0, 1.0, "probability that an external pose is missing"),
}


def _bar(measure: str, meaning: str, unit: str = "") -> Range:
    return Range(0.0, 1.0 if unit == "%" else math.inf, meaning, measure, unit)


BARS = {
    "min_success": _bar("success", "share of the trials that succeed", "%"),
    "min_crossed": _bar(
        "crossed",
        "share of the trials whose true robot crosses at each planned crossing",
        "%",
    ),
    "min_planned": _bar("planned", "share of the trials that have a plan", "%"),
    "max_error": _bar("max_error", "largest true error of any trial, m", "mm"),
    "median_error": _bar(
        "median_error", "median over the trials of their largest true error, m", "mm"
    ),
    "max_end_error": _bar(
        "max_end_error", "largest true error at the end of any trial, m", "mm"
    ),
    "max_peak_near": _bar(
        "peak_ratio_near", "largest torque near the locus over the planned peak"
    ),
    "max_saturated": _bar(
        "saturated", "largest number of saturated ticks of any trial"
    ),
    "min_recognised": _bar(
        "recognised", "share of the bounces that are called bounces", "%"
    ),
    "max_wrong_crossed": _bar(
        "wrong_crossed",
        "crossings called so that did not happen, in all trials together",
    ),
    "max_held_wrong": _bar(
        "held_wrong", "trials at whose end the robot is held on the wrong side"
    ),
    "max_wrong_side_time": _bar(
        "wrong_side_time",
        "longest time of any trial under a law on the wrong side, clear of the"
        " locus, s",
    ),
    "max_stopped_after_crossing": _bar(
        "stopped_after_crossing",
        "trials that are stopped after the true robot made the first crossing",
    ),
    "max_false_alarms": _bar(
        "false_alarms", "crossings called bounces, in all trials together"
    ),
    "max_bounce_torque": _bar(
        "torque_after_bounce", "largest torque from a bounce on over the planned peak"
    ),
    "min_safe_after": _bar(
        "safe_after",
        "share of the recognised bounces whose torque brakes or is gone within 30 ms",
        "%",
    ),
}
