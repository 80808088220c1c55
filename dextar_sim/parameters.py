"""The plant node's parameters; their defaults stand in ``config/crossing.yaml``."""

from __future__ import annotations

from dextar_control.contract.node import Parameter

PARAMETERS = (
    Parameter("mode", "realtime runs on at the steady clock's pace as a rig does, lockstep waits for each command",
              choices=("realtime", "lockstep")),
    Parameter("real_time_factor", "pace in lockstep, simulated over real time: a machine that cannot keep it up is slower; 0 is "
              "as fast as possible", minimum=0.0, maximum=100.0, unit="1"),
    Parameter("clock_rate", "of the topic clock in lockstep, in simulated time; 0 is none",
              minimum=0.0, maximum=1.0e4, unit="Hz"),
    Parameter("command_interface", "joint_state reads joint_commands, effort_array (real time only) reads effort_commands",
              choices=("joint_state", "effort_array")),
    Parameter("substeps", "physics steps in one sample period", minimum=1, maximum=1000),
    Parameter("start_paused", "publish nothing until resumed"),
    Parameter("step_count", "samples that one call of ~/step advances", minimum=1, maximum=1_000_000, live=True),
    Parameter("encoder_resolution", "counts per revolution; 0 is exact", minimum=0, maximum=2**31, unit="1"),
    Parameter("position_noise", "standard deviation before quantisation", minimum=0.0, maximum=1.0, unit="rad"),
    Parameter("velocity_cutoff", "of the drive's velocity estimate; 0 is unfiltered", minimum=0.0, maximum=1.0e5, unit="Hz"),
    Parameter("command_delay", "from a command's arrival to its effect, rounded to sample periods",
              minimum=0.0, maximum=1.0, unit="s"),
    Parameter("command_timeout", "without a fresh command after which there is no torque: simulated time, in real time the "
              "steady clock too", minimum=1.0e-4, maximum=1.0e3, unit="s"),
    Parameter("max_torque", "saturation of the drives; 0 takes the robot's", minimum=0.0, maximum=1.0e4, unit="N m"),
    Parameter("pose_rate", "of the external measurements of the end effector; 0 is none", minimum=0.0, maximum=1.0e4, unit="Hz"),
    Parameter("pose_delay", "from the instant when an external measurement was true to its arrival",
              minimum=0.0, maximum=10.0, unit="s"),
    Parameter("pose_noise", "standard deviation of each coordinate of an external measurement",
              minimum=0.0, maximum=1.0, unit="m"),
    Parameter("friction", "how Coulomb friction changes sign: stick holds a joint at rest, smooth is a tanh over coulomb_speed",
              choices=("stick", "smooth")),
    Parameter("encoder_at", "of a compliant transmission: its motor or its link side", choices=("motor", "link")),
    Parameter("backlash", "of each transmission, from one end to the other", minimum=0.0, maximum=0.1, unit="rad"),
    Parameter("cogging", "amplitude of each motor's torque over its angle", minimum=0.0, maximum=1.0e3, unit="N m"),
    Parameter("cogging_periods", "of it in one revolution", minimum=1, maximum=1000, unit="1"),
    Parameter("drive_lag", "time constant of a torque", minimum=0.0, maximum=1.0, unit="s"),
    Parameter("torque_step", "to whole multiples of which commands are rounded; 0 does not", minimum=0.0, maximum=1.0e3,
              unit="N m"),
    Parameter("homing_error", "by which each encoder is off, to one side or the other", minimum=0.0, maximum=0.5, unit="rad"),
    Parameter("eccentricity", "amplitude of each encoder's error over a turn", minimum=0.0, maximum=0.1, unit="rad"),
    Parameter("stamp_error", "up to which a state's stamp is off, at random", minimum=0.0, maximum=0.05, unit="s"),
    Parameter("payload", "mass that the end effector takes up", minimum=0.0, maximum=100.0, unit="kg"),
    Parameter("payload_time", "at which it does, after the start or ~/reset", minimum=0.0, maximum=1.0e6, unit="s"),
    Parameter("push", "force on the end effector", size=2, unit="N"),
    Parameter("push_time", "at which it begins, after the start or ~/reset", minimum=0.0, maximum=1.0e6, unit="s"),
    Parameter("push_duration", "for which it acts", minimum=0.0, maximum=100.0, unit="s"),
    Parameter("seed", "of all noise", minimum=0, maximum=2**31),
    Parameter("publish_truth", "publish sim/end_effector and sim/joint_states"),
    Parameter("window", "open PyBullet's own window"),
    Parameter("task.start", "end effector at the start and after ~/reset", size=2, unit="m"),
    Parameter("task.sample_period", "of the plant's samples", minimum=1.0e-4, maximum=0.1, unit="s"),
)  # fmt: skip
