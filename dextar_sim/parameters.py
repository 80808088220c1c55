"""The plant node's parameters; their defaults stand in ``config/crossing.yaml``."""

from __future__ import annotations

from dextar_control.contract.parameters import SCHEDULING, Parameter

PARAMETERS = (
    *SCHEDULING,
    Parameter(
        "mode",
        "The plant runs at the pace of the steady clock as a rig does (realtime) or"
        " waits for each command (lockstep).",
        choices=("realtime", "lockstep"),
    ),
    Parameter(
        "real_time_factor",
        "In lockstep, simulated time runs at most this many times as fast as real time;"
        " 0 sets no limit.",
        minimum=0.0,
        maximum=100.0,
        unit="1",
    ),
    Parameter(
        "clock_rate",
        "In lockstep, the plant publishes the topic clock at this rate of simulated"
        " time; 0 publishes none.",
        minimum=0.0,
        maximum=1.0e4,
        unit="Hz",
    ),
    Parameter(
        "command_interface",
        "The plant reads joint_commands (joint_state) or, in real time only,"
        " effort_commands (effort_array).",
        choices=("joint_state", "effort_array"),
    ),
    Parameter(
        "substeps",
        "The physics engine takes this many steps in one sample period.",
        minimum=1,
        maximum=1000,
    ),
    Parameter(
        "start_paused",
        "The plant starts paused and waits until ~/pause is called with false.",
    ),
    Parameter(
        "step_count",
        "One call of ~/step advances a paused plant by this many samples.",
        minimum=1,
        maximum=1_000_000,
        live=True,
    ),
    Parameter(
        "encoder_resolution",
        "The encoders count this many steps per revolution; 0 makes them exact.",
        minimum=0,
        maximum=2**31,
        unit="1",
    ),
    Parameter(
        "position_noise",
        "The joint angles have noise of this standard deviation before they are"
        " quantised.",
        minimum=0.0,
        maximum=1.0,
        unit="rad",
    ),
    Parameter(
        "velocity_cutoff",
        "The drive's velocity estimate is low-pass filtered at this frequency; 0 leaves"
        " it unfiltered.",
        minimum=0.0,
        maximum=1.0e5,
        unit="Hz",
    ),
    Parameter(
        "command_delay",
        "A command acts this long after it arrives, rounded to sample periods.",
        minimum=0.0,
        maximum=1.0,
        unit="s",
    ),
    Parameter(
        "command_timeout",
        "The drives give no torque when the state that the newest command answers is"
        " older than this; in real time its arrival counts too.",
        minimum=1.0e-4,
        maximum=1.0e3,
        unit="s",
    ),
    Parameter(
        "max_torque",
        "The drives saturate at this torque; 0 takes the robot's max_torque.",
        minimum=0.0,
        maximum=1.0e4,
        unit="N m",
    ),
    Parameter(
        "pose_rate",
        "The plant measures the end effector's position from outside at this rate; 0"
        " measures nothing.",
        minimum=0.0,
        maximum=1.0e4,
        unit="Hz",
    ),
    Parameter(
        "pose_delay",
        "An external measurement arrives this long after the instant when it was true.",
        minimum=0.0,
        maximum=10.0,
        unit="s",
    ),
    Parameter(
        "pose_noise",
        "Each coordinate of an external measurement has noise of this standard"
        " deviation.",
        minimum=0.0,
        maximum=1.0,
        unit="m",
    ),
    Parameter(
        "friction",
        "Coulomb friction holds a joint at rest (stick) or follows a tanh over the"
        " robot's coulomb_speed (smooth).",
        choices=("stick", "smooth"),
    ),
    Parameter(
        "encoder_at",
        "The encoders sit on the motor or on the link side of a compliant"
        " transmission.",
        choices=("motor", "link"),
    ),
    Parameter(
        "backlash",
        "Each transmission has this backlash from one end to the other.",
        minimum=0.0,
        maximum=0.1,
        unit="rad",
    ),
    Parameter(
        "cogging",
        "The cogging torque of each motor has this amplitude.",
        minimum=0.0,
        maximum=1.0e3,
        unit="N m",
    ),
    Parameter(
        "cogging_periods",
        "The cogging torque has this many periods in one revolution.",
        minimum=1,
        maximum=1000,
        unit="1",
    ),
    Parameter(
        "drive_lag",
        "The drives' torques follow their commands with this time constant.",
        minimum=0.0,
        maximum=1.0,
        unit="s",
    ),
    Parameter(
        "torque_step",
        "The drives round commands to whole multiples of this torque; 0 does not"
        " round.",
        minimum=0.0,
        maximum=1.0e3,
        unit="N m",
    ),
    Parameter(
        "homing_error",
        "The zero of each encoder is off by this much, with a random sign.",
        minimum=0.0,
        maximum=0.5,
        unit="rad",
    ),
    Parameter(
        "eccentricity",
        "Each encoder has a sinusoidal error of this amplitude over a turn.",
        minimum=0.0,
        maximum=0.1,
        unit="rad",
    ),
    Parameter(
        "stamp_error",
        "The stamp of each state is off by a random time of up to this, less than half"
        " the sample period.",
        minimum=0.0,
        maximum=0.05,
        unit="s",
    ),
    Parameter(
        "payload",
        "The end effector takes up a payload of this mass.",
        minimum=0.0,
        maximum=100.0,
        unit="kg",
    ),
    Parameter(
        "payload_time",
        "The payload is taken up at this time after the start or ~/reset.",
        minimum=0.0,
        maximum=1.0e6,
        unit="s",
    ),
    Parameter(
        "push", "A push exerts this force on the end effector.", size=2, unit="N"
    ),
    Parameter(
        "push_time",
        "The push begins at this time after the start or ~/reset.",
        minimum=0.0,
        maximum=1.0e6,
        unit="s",
    ),
    Parameter(
        "push_duration",
        "The push lasts this long.",
        minimum=0.0,
        maximum=100.0,
        unit="s",
    ),
    Parameter(
        "seed",
        "All simulated noise follows from this seed of the random numbers.",
        minimum=0,
        maximum=2**31,
    ),
    Parameter(
        "publish_truth",
        "The plant publishes the true state on sim/end_effector and sim/joint_states.",
    ),
    Parameter("window", "The plant opens PyBullet's own window."),
    Parameter(
        "task.start",
        "The end effector stands here at the start and after ~/reset.",
        size=2,
        unit="m",
    ),
    Parameter(
        "task.sample_period",
        "The plant publishes its joint states once in this period.",
        minimum=1.0e-4,
        maximum=0.1,
        unit="s",
    ),
)
