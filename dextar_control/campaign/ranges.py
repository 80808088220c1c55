"""What a campaign may perturb, and what it may ask of a case: names, units, limits."""

from __future__ import annotations

import math
from typing import NamedTuple


class Range(NamedTuple):
    """A number's closed interval and its meaning."""

    low: float
    high: float
    meaning: str


PERTURBATIONS = {
    "masses": Range(0.0, 0.9, "relative error of every mass and inertia of the true robot"),
    "geometry": Range(0.0, 5e-3, "error of each of the eight geometric parameters of the true robot, m"),
    "coulomb": Range(0.0, 1.0, "Coulomb friction at each motor of the true robot, N m"),
    "coulomb_modelled": Range(0.0, 2.0, "share of that friction which the controller's model has"),
    "command_delay": Range(0.0, 0.1, "from command to drive, s"),
    "sample_loss": Range(0.0, 0.99, "probability that a sample never reaches the controller"),
    "encoder_resolution": Range(0.0, 2.0**32, "counts per revolution; 0 is exact"),
    "jitter": Range(0.0, 1.0, "share of the period by which a command arrives late at random"),
    "position_noise": Range(0.0, 0.1, "standard deviation of a joint position before quantisation, rad"),
    "bounce": Range(0.0, 1.0, "1: an impulse against the motion at the locus"),
    "pose_rate": Range(0.0, 1000.0, "of the external pose measurement, Hz; 0: none"),
    "pose_delay": Range(0.0, 1.0, "of the external pose measurement, s"),
    "pose_noise": Range(0.0, 0.1, "standard deviation of each coordinate of the external pose, m"),
    "pose_dropout": Range(0.0, 1.0, "probability that an external pose is missing"),
}

BARS = {
    "min_success": Range(0.0, 1.0, "share of the trials that succeed"),
    "min_crossed": Range(0.0, 1.0, "share of the trials whose true robot crosses at each planned crossing"),
    "min_planned": Range(0.0, 1.0, "share of the trials that have a plan"),
    "max_error": Range(0.0, math.inf, "largest true error of any trial, m"),
    "median_error": Range(0.0, math.inf, "median over the trials of their largest true error, m"),
    "max_end_error": Range(0.0, math.inf, "largest true error at the end of any trial, m"),
    "max_peak_near": Range(0.0, math.inf, "largest torque near the locus over the planned peak"),
    "max_saturated": Range(0.0, math.inf, "largest number of saturated ticks of any trial"),
    "min_recognised": Range(0.0, 1.0, "share of the bounces that are called bounces"),
    "max_false_alarms": Range(0.0, math.inf, "crossings called bounces, in all trials together"),
    "max_bounce_torque": Range(0.0, math.inf, "largest torque from a bounce on over the planned peak"),
    "min_safe_after": Range(0.0, 1.0, "share of the recognised bounces whose torque brakes or is gone within 30 ms"),
}
