"""The controller's parameters; their defaults stand in ``config/crossing.yaml``.

A name that ends in ``abs_s`` is a limit of |s|; one that ends in ``time`` or
``timeout`` is in seconds.
"""

from __future__ import annotations

from dextar_control.contract.parameters import SCHEDULING, Parameter

LAWS = ("classic", "projected", "consistent", "multi_model", "joint_space")
"""Ours by their names, which ``control.law`` has."""
ESTIMATORS = ("plain", "dgm", "observer", "external")
"""Ours by their names, which ``estimation.estimator`` has."""

CONTROLLER = (
    Parameter(
        "law",
        "The control law computes the torques from the tracking error; the laws differ"
        " near the Type 2 locus.",
        choices=LAWS,
        own=True,
    ),
    Parameter(
        "estimator",
        "The estimator finds the platform's state and assembly mode from the encoders;"
        " external also takes measured positions.",
        choices=ESTIMATORS,
        own=True,
    ),
    Parameter(
        "autostart",
        "The controller configures and activates itself at its start; if false, it"
        " waits for the lifecycle services.",
    ),
    Parameter(
        "enabled",
        "The controller enables itself once the joint states have been healthy for"
        " joint_states.healthy_time; if false, it waits for ~/enable.",
    ),
    Parameter(
        "lockstep",
        "Joint states are read reliably and may come at any pace, as from a plant in"
        " lockstep.",
    ),
    Parameter(
        "assembly_mode",
        "The robot stands in the assembly mode with this sign of s, +1 or -1; it"
        " changes only while no torque acts.",
        (-1, 1),
        live=True,
    ),
    *SCHEDULING,
    Parameter(
        "task.sample_period",
        "The control loop expects a joint state once in this period.",
        (1e-4, 0.1),
        unit="s",
    ),
    Parameter(
        "joint_states.healthy_time",
        "Joint states must have come without gap, refusal, repetition or step back for"
        " this long before torque is allowed; 0 allows it at once.",
        (0.0, 60.0),
        unit="s",
        live=True,
        formerly="healthy_time",
    ),
    Parameter(
        "joint_states.timeout",
        "A gap longer than this between the stamps of two states is a fault; a silence"
        " this long takes the torque away until the next state.",
        (1e-3, 10.0),
        unit="s",
        live=True,
        formerly="state_timeout",
    ),
    Parameter(
        "joint_states.stall_timeout",
        "A silence of the joint states that is longer than this by the steady clock is"
        " a fault, except in lockstep.",
        (1e-3, 60.0),
        unit="s",
        live=True,
        formerly="stall_timeout",
    ),
    Parameter(
        "trajectory.wait_timeout",
        "A trajectory is dropped when it has to wait longer than this for its start or"
        " for the controller to be enabled.",
        (0.0, 3600.0),
        unit="s",
        live=True,
        formerly="reference_timeout",
    ),
    Parameter(
        "trajectory.max_age",
        "A trajectory is refused when it arrives more than this after it was served, or"
        " before it by the clocks.",
        (1e-3, 3600.0),
        unit="s",
        live=True,
        formerly="max_reference_age",
    ),
    Parameter(
        "trajectory.max_start_distance",
        "A trajectory is refused when it starts farther than this from the point that"
        " the robot holds.",
        (1e-5, 0.05),
        unit="m",
        live=True,
        formerly="max_start_distance",
    ),
    Parameter(
        "trajectory.max_residual",
        "A trajectory is refused when the residual of the crossing criterion exceeds"
        " this at one of its crossings.",
        (1e-12, 10.0),
        unit="N",
        live=True,
        formerly="max_residual",
    ),
    Parameter(
        "publish.effort_array",
        "The controller publishes its torques on effort_commands too, for drivers that"
        " read an array.",
        formerly="publish_effort_array",
    ),
    Parameter(
        "publish.readable",
        "The controller publishes its state and criterion on .../readable too, as"
        " messages of dextar_interfaces.",
        formerly="publish_readable",
    ),
    Parameter(
        "feedback.natural_frequency",
        "The feedback gives the tracking error this natural frequency; the proportional"
        " gain K_p is its square.",
        (1.0, 500.0),
        unit="rad/s",
        live=True,
        formerly="natural_frequency",
    ),
    Parameter(
        "feedback.damping_ratio",
        "The feedback gives the tracking error this damping ratio; the derivative gain"
        " is K_d = 2 damping_ratio natural_frequency.",
        (0.1, 5.0),
        unit="1",
        live=True,
        formerly="damping_ratio",
    ),
    Parameter(
        "feedback.integral_frequency",
        "The integral gain is K_i = integral_frequency natural_frequency^2; 0 switches"
        " the integral term off.",
        (0.0, 50.0),
        unit="1/s",
        live=True,
        formerly="integral_frequency",
    ),
    Parameter(
        "compensation.friction",
        "The controller feeds this fraction of the modelled joint friction forward.",
        (0.0, 1.5),
        unit="1",
        live=True,
        formerly="friction_compensation",
    ),
    Parameter(
        "compensation.disturbance",
        "The controller compensates this fraction of the disturbance torques that the"
        " observer estimates.",
        (0.0, 1.5),
        unit="1",
        live=True,
        formerly="disturbance_compensation",
    ),
    Parameter(
        "near_locus.fade_abs_s",
        "Along the weak direction the laws consistent and joint_space fade from planned"
        " multipliers to feedback around this |s|.",
        (0.0, 0.9),
        unit="1",
        live=True,
        formerly="zone",
    ),
    Parameter(
        "near_locus.fade_width_abs_s",
        "The fading of the laws consistent and joint_space spans this width in |s|, at"
        " most twice fade_abs_s.",
        (0.0, 0.9),
        unit="1",
        live=True,
        formerly="zone_width",
    ),
    Parameter(
        "near_locus.replace_below_abs_s",
        "The laws projected and multi_model replace the regular inverse dynamics where"
        " |s| is below this.",
        (0.0, 0.9),
        unit="1",
        live=True,
        formerly="band",
    ),
    Parameter(
        "dgm.hold_below_abs_s",
        "The estimator dgm does not call the direct geometric model where the"
        " reference's |s| is below this; phase CROSSING reaches"
        " fade_width_abs_s farther.",
        (0.0, 0.9),
        unit="1",
        live=True,
        formerly="hold_zone",
    ),
    Parameter(
        "dgm.fade_width_abs_s",
        "The estimator dgm fades the direct geometric model in over this width of |s|"
        " outside hold_below_abs_s.",
        (0.0, 0.9),
        unit="1",
        live=True,
        formerly="hold_width",
    ),
    Parameter(
        "dgm.fade_time",
        "The estimator dgm fades the direct geometric model in over this time after the"
        " reference has left hold_below_abs_s.",
        (0.0, 1.0),
        unit="s",
        live=True,
        formerly="return_time",
    ),
    Parameter(
        "joint_filter.bandwidth",
        "The estimators dgm and plain, and the safe stop with any estimator, filter the"
        " joints with this bandwidth.",
        (10.0, 2000.0),
        unit="rad/s",
        live=True,
        formerly="filter_bandwidth",
    ),
    Parameter(
        "observer.encoder_deviation",
        "The observer takes an encoder sample to have at least this standard"
        " deviation.",
        (1e-7, 0.1),
        unit="rad",
        live=True,
        formerly="encoder_deviation",
    ),
    Parameter(
        "observer.scatter_gain",
        "The observer adds this many times the variance of the scatter that it sees in"
        " the encoder samples to theirs; 0 adds none.",
        (0.0, 1e6),
        unit="1",
        live=True,
        formerly="scatter_gain",
    ),
    Parameter(
        "observer.bias_deviation",
        "At its start the observer takes the joint angle bias that a wrong geometry"
        " causes to have this standard deviation.",
        (1e-9, 0.1),
        unit="rad",
        live=True,
        formerly="bias_deviation",
    ),
    Parameter(
        "observer.bias_walk",
        "The observer lets the joint angle bias drift as a random walk of this"
        " deviation as the joints move.",
        (0.0, 0.1),
        unit="rad/sqrt(rad)",
        live=True,
        formerly="bias_walk",
    ),
    Parameter(
        "observer.torque_deviation",
        "The observer takes the torque of each sample to be off by this standard"
        " deviation (friction, motors).",
        (1e-6, 10.0),
        unit="N m",
        live=True,
        formerly="torque_deviation",
    ),
    Parameter(
        "observer.acceleration_deviation",
        "The observer takes the modelled platform acceleration of each sample to be off"
        " by this standard deviation (masses).",
        (0.0, 1e3),
        unit="m/s^2",
        live=True,
        formerly="acceleration_deviation",
    ),
    Parameter(
        "observer.disturbance_deviation",
        "At its start the observer takes the disturbance torque at a joint, which the"
        " model lacks, to have this standard deviation.",
        (0.0, 10.0),
        unit="N m",
        live=True,
        formerly="disturbance_deviation",
    ),
    Parameter(
        "observer.disturbance_walk",
        "The observer lets the disturbance torques drift as a random walk of this"
        " deviation; with disturbance_deviation 0 too it estimates none.",
        (0.0, 100.0),
        unit="N m/sqrt(s)",
        live=True,
        formerly="disturbance_walk",
    ),
    Parameter(
        "observer.impact_gate",
        "The observer assumes an impact when the innovation of the joints exceeds this"
        " many standard deviations.",
        (1.0, 1e6),
        unit="deviations",
        live=True,
        formerly="shock_gate",
    ),
    Parameter(
        "observer.impact_speed",
        "The observer takes an impact to change the platform's velocity by this"
        " standard deviation.",
        (0.0, 100.0),
        unit="m/s",
        live=True,
        formerly="shock_speed",
    ),
    Parameter(
        "crossing_test.unknown_below_abs_s",
        "The observer takes the assembly mode as unknown once |s| falls below this,"
        " which must be less than begin_below_abs_s.",
        (0.0, 0.9),
        unit="1",
        live=True,
        formerly="passage_armed",
    ),
    Parameter(
        "crossing_test.begin_below_abs_s",
        "The observer begins its sequential test of crossed against bounced at this"
        " |s|.",
        (0.0, 0.9),
        unit="1",
        live=True,
        formerly="passage_begin",
    ),
    Parameter(
        "crossing_test.log_odds",
        "The test of crossed against bounced decides when its log-odds reach this"
        " magnitude.",
        (0.1, 20.0),
        unit="1",
        live=True,
        formerly="passage_log_odds",
    ),
    Parameter(
        "crossing_test.encoder_deviation",
        "The test of crossed against bounced takes an encoder sample to have at least"
        " this standard deviation.",
        (1e-7, 0.1),
        unit="rad",
        live=True,
        formerly="passage_encoder_deviation",
    ),
    Parameter(
        "crossing_test.bias_deviation",
        "The test of crossed against bounced takes the joint angle bias to have this"
        " standard deviation.",
        (1e-9, 0.1),
        unit="rad",
        live=True,
        formerly="passage_bias_deviation",
    ),
    Parameter(
        "crossing_test.torque_deviation",
        "The test of crossed against bounced takes the torque of each sample to be off"
        " by this standard deviation.",
        (1e-6, 10.0),
        unit="N m",
        live=True,
        formerly="passage_torque_deviation",
    ),
    Parameter(
        "crossing_test.acceleration_deviation",
        "The test of crossed against bounced takes the modelled platform acceleration"
        " to be off by this standard deviation.",
        (0.0, 1e3),
        unit="m/s^2",
        live=True,
        formerly="passage_acceleration_deviation",
    ),
    Parameter(
        "crossing_test.max_disturbance",
        "The test of crossed against bounced allows for the disturbance torque"
        " estimated before it, up to this at each joint.",
        (0.0, 10.0),
        unit="N m",
        live=True,
        formerly="passage_disturbance",
    ),
    Parameter(
        "external.position_deviation",
        "The estimator external takes each coordinate of a measured position to have"
        " this standard deviation.",
        (1e-6, 0.1),
        unit="m",
        live=True,
        formerly="pose_deviation",
    ),
    Parameter(
        "external.position_gate",
        "The estimator external refuses a position farther than this many standard"
        " deviations from its estimate and the mirror image.",
        (1.0, 1e3),
        unit="deviations",
        live=True,
        formerly="pose_gate",
    ),
    Parameter(
        "external.timeout",
        "The estimator external warns when no measured position has come for this long,"
        " and uses the encoders alone.",
        (1e-3, 10.0),
        unit="s",
        live=True,
        formerly="pose_timeout",
    ),
    Parameter(
        "mode_check.above_abs_s",
        "The believed assembly mode is compared with the plan's where the reference's"
        " |s| is at least this.",
        (0.0, 0.9),
        unit="1",
        live=True,
        formerly="verdict_s",
    ),
    Parameter(
        "mode_check.confidence",
        "The believed assembly mode counts as known from this probability on.",
        (0.6, 0.99999999),
        unit="1",
        live=True,
        formerly="verdict_confidence",
    ),
    Parameter(
        "mode_check.unknown_time",
        "A safe stop begins when the assembly mode stays unknown this long away from"
        " the locus after an error above unknown_error.",
        (0.0, 1e3),
        unit="s",
        live=True,
        formerly="side_time",
    ),
    Parameter(
        "mode_check.unknown_error",
        "An unknown assembly mode is tolerated while the tracking error since it was"
        " last known has not exceeded this.",
        (0.0, 0.2),
        unit="m",
        live=True,
        formerly="side_error",
    ),
    Parameter(
        "torque_limit.peak_ratio",
        "On a crossing trajectory each torque is limited to this multiple of the"
        " planned peak torque, or to min_torque where that is larger.",
        (1.0, 1e6),
        unit="1",
        live=True,
        formerly="watch_ratio",
    ),
    Parameter(
        "torque_limit.min_torque",
        "On a crossing trajectory the torque limit is at least this, and grows by at"
        " most this for an estimated disturbance.",
        (0.0, 100.0),
        unit="N m",
        live=True,
        formerly="watch_torque",
    ),
    Parameter(
        "torque_limit.time",
        "A safe stop begins when a torque stays at its limit this long while the mode"
        " is unknown or the error does not shrink.",
        (0.0, 10.0),
        unit="s",
        live=True,
        formerly="watch_time",
    ),
    Parameter(
        "watch.max_tracking_error",
        "A safe stop begins when the estimated platform is farther than this from its"
        " reference.",
        (1e-4, 0.2),
        unit="m",
        live=True,
        formerly="max_tracking_error",
    ),
    Parameter(
        "watch.speed_margin",
        "A speed may reach this multiple of the robot's max_joint_speed or"
        " max_platform_speed.",
        (1.0, 10.0),
        unit="1",
        live=True,
        formerly="speed_margin",
    ),
    Parameter(
        "watch.speed_time",
        "A safe stop begins when a speed exceeds what speed_margin allows for this"
        " long.",
        (0.0, 10.0),
        unit="s",
        live=True,
        formerly="speed_time",
    ),
    Parameter(
        "watch.joint_margin",
        "A safe stop begins when a joint is farther than this outside its range.",
        (0.0, 1.0),
        unit="rad",
        live=True,
        formerly="joint_margin",
    ),
    Parameter(
        "watch.max_joint_jump",
        "A safe stop begins when a joint is farther than this from where the last"
        " estimate expected it.",
        (1e-4, 3.2),
        unit="rad",
        live=True,
        formerly="max_joint_jump",
    ),
    Parameter(
        "watch.max_joint_misfit",
        "A measured joint may differ by this from the joint angle of the estimated"
        " platform.",
        (1e-4, 3.2),
        unit="rad",
        live=True,
        formerly="max_joint_misfit",
    ),
    Parameter(
        "watch.joint_misfit_time",
        "A safe stop begins when a joint exceeds max_joint_misfit for this long.",
        (0.0, 10.0),
        unit="s",
        live=True,
        formerly="misfit_time",
    ),
    Parameter(
        "watch.min_abs_s",
        "A safe stop begins when the estimated |s| falls below this outside phase"
        " CROSSING.",
        (0.0, 0.9),
        unit="1",
        live=True,
        formerly="locus_s",
    ),
    Parameter(
        "watch.max_torque_rate",
        "A torque may change at this rate, relative to the robot's max_torque.",
        (1.0, 1e6),
        unit="1/s",
        live=True,
        formerly="max_torque_rate",
    ),
    Parameter(
        "watch.torque_rate_time",
        "A safe stop begins when a torque exceeds max_torque_rate for this long.",
        (0.0, 10.0),
        unit="s",
        live=True,
        formerly="torque_rate_time",
    ),
    Parameter(
        "safe_stop.brake_gain",
        "The safe stop damps each joint with this gain where the assembly mode is"
        " unknown.",
        (0.0, 10.0),
        unit="N m s/rad",
        live=True,
        formerly="brake_gain",
    ),
    Parameter(
        "safe_stop.brake_time",
        "The safe stop takes its torque away this long after it began, even if the"
        " robot still moves.",
        (0.0, 10.0),
        unit="s",
        live=True,
        formerly="brake_time",
    ),
    Parameter(
        "safe_stop.brake_time_constant",
        "The safe stop lets the velocity decay with this time constant where the"
        " assembly mode is known.",
        (0.005, 1.0),
        unit="s",
        live=True,
        formerly="brake_constant",
    ),
    Parameter(
        "safe_stop.coast_below_abs_s",
        "The safe stop coasts without torque where |s| is below this.",
        (0.02, 0.9),
        unit="1",
        live=True,
        formerly="coast_s",
    ),
    Parameter(
        "safe_stop.rest_above_abs_s",
        "The safe stop brakes only where the robot would come to rest at an |s| of at"
        " least this.",
        (0.02, 0.9),
        unit="1",
        live=True,
        formerly="stop_s",
    ),
    Parameter(
        "safe_stop.coast_time",
        "The safe stop gives no more torque after it has coasted for this long in all.",
        (0.0, 10.0),
        unit="s",
        live=True,
        formerly="coast_time",
    ),
    Parameter(
        "safe_stop.rest_time",
        "The safe stop is over when the joints have rested for this long.",
        (0.01, 10.0),
        unit="s",
        live=True,
        formerly="rest_time",
    ),
)
