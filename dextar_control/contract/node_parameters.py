"""The parameters of all nodes; their defaults stand in ``config/crossing.yaml``."""

from __future__ import annotations

from dextar_control.contract.controller_parameters import CONTROLLER
from dextar_control.contract.parameters import SCHEDULING, Parameter

PLANT = (
    Parameter(
        "mode",
        "The plant runs at the pace of the steady clock as a rig does (realtime) or"
        " waits for each command (lockstep).",
        choices=("realtime", "lockstep"),
    ),
    Parameter(
        "command_interface",
        "The plant reads joint_commands (joint_state) or, in real time only,"
        " effort_commands (effort_array).",
        choices=("joint_state", "effort_array"),
    ),
    Parameter(
        "seed",
        "All simulated noise follows from this seed of the random numbers.",
        (0, 2**31),
    ),
    Parameter("window", "The plant opens PyBullet's own window."),
    *SCHEDULING,
    Parameter(
        "task.start",
        "The end effector stands here at the start and after ~/reset.",
        size=2,
        unit="m",
    ),
    Parameter(
        "task.sample_period",
        "The plant publishes its joint states once in this period.",
        (1.0e-4, 0.1),
        unit="s",
    ),
    Parameter(
        "simulation.real_time_factor",
        "In lockstep, simulated time runs at most this many times as fast as real time;"
        " 0 sets no limit.",
        (0.0, 100.0),
        unit="1",
        formerly="real_time_factor",
    ),
    Parameter(
        "simulation.clock_rate",
        "In lockstep, the plant publishes the topic clock at this rate of simulated"
        " time; 0 publishes none.",
        (0.0, 1.0e4),
        unit="Hz",
        formerly="clock_rate",
    ),
    Parameter(
        "simulation.substeps",
        "The physics engine takes this many steps in one sample period.",
        (1, 1000),
        formerly="substeps",
    ),
    Parameter(
        "simulation.start_paused",
        "The plant starts paused and waits until ~/pause is called with false.",
        formerly="start_paused",
    ),
    Parameter(
        "simulation.step_count",
        "One call of ~/step advances a paused plant by this many samples.",
        (1, 1_000_000),
        live=True,
        formerly="step_count",
    ),
    Parameter(
        "publish.truth",
        "The plant publishes the true state on sim/end_effector and sim/joint_states.",
        formerly="publish_truth",
    ),
    Parameter(
        "encoder.resolution",
        "The encoders count this many steps per revolution; 0 makes them exact.",
        (0, 2**31),
        unit="1",
        formerly="encoder_resolution",
    ),
    Parameter(
        "encoder.noise",
        "The joint angles have noise of this standard deviation before they are"
        " quantised.",
        (0.0, 1.0),
        unit="rad",
        formerly="position_noise",
    ),
    Parameter(
        "encoder.velocity_cutoff",
        "The drive's velocity estimate is low-pass filtered at this frequency; 0 leaves"
        " it unfiltered.",
        (0.0, 1.0e5),
        unit="Hz",
        formerly="velocity_cutoff",
    ),
    Parameter(
        "encoder.side",
        "The encoders sit on the motor or on the link side of a compliant"
        " transmission.",
        choices=("motor", "link"),
        formerly="encoder_at",
    ),
    Parameter(
        "encoder.homing_error",
        "The zero of each encoder is off by this much, with a random sign.",
        (0.0, 0.5),
        unit="rad",
        formerly="homing_error",
    ),
    Parameter(
        "encoder.eccentricity",
        "Each encoder has a sinusoidal error of this amplitude over a turn.",
        (0.0, 0.1),
        unit="rad",
        formerly="eccentricity",
    ),
    Parameter(
        "encoder.stamp_error",
        "The stamp of each state is off by a random time of up to this, less than half"
        " the sample period.",
        (0.0, 0.05),
        unit="s",
        formerly="stamp_error",
    ),
    Parameter(
        "drive.command_delay",
        "A command acts this long after it arrives, rounded to sample periods.",
        (0.0, 1.0),
        unit="s",
        formerly="command_delay",
    ),
    Parameter(
        "drive.command_timeout",
        "The drives give no torque when the state that the newest command answers is"
        " older than this; in real time its arrival counts too.",
        (1.0e-4, 1.0e3),
        unit="s",
        formerly="command_timeout",
    ),
    Parameter(
        "drive.max_torque",
        "The drives saturate at this torque; 0 takes the robot's max_torque.",
        (0.0, 1.0e4),
        unit="N m",
        formerly="max_torque",
    ),
    Parameter(
        "drive.cogging",
        "The cogging torque of each motor has this amplitude.",
        (0.0, 1.0e3),
        unit="N m",
        formerly="cogging",
    ),
    Parameter(
        "drive.cogging_periods",
        "The cogging torque has this many periods in one revolution.",
        (1, 1000),
        unit="1",
        formerly="cogging_periods",
    ),
    Parameter(
        "drive.lag",
        "The drives' torques follow their commands with this time constant.",
        (0.0, 1.0),
        unit="s",
        formerly="drive_lag",
    ),
    Parameter(
        "drive.torque_step",
        "The drives round commands to whole multiples of this torque; 0 does not"
        " round.",
        (0.0, 1.0e3),
        unit="N m",
        formerly="torque_step",
    ),
    Parameter(
        "mechanics.backlash",
        "Each transmission has this backlash from one end to the other.",
        (0.0, 0.1),
        unit="rad",
        formerly="backlash",
    ),
    Parameter(
        "mechanics.friction",
        "Coulomb friction holds a joint at rest (stick) or follows a tanh over the"
        " robot's coulomb_speed (smooth).",
        choices=("stick", "smooth"),
        formerly="friction",
    ),
    Parameter(
        "external_pose.rate",
        "The plant measures the end effector's position from outside at this rate; 0"
        " measures nothing.",
        (0.0, 1.0e4),
        unit="Hz",
        formerly="pose_rate",
    ),
    Parameter(
        "external_pose.delay",
        "An external measurement arrives this long after the instant when it was true.",
        (0.0, 10.0),
        unit="s",
        formerly="pose_delay",
    ),
    Parameter(
        "external_pose.noise",
        "Each coordinate of an external measurement has noise of this standard"
        " deviation.",
        (0.0, 1.0),
        unit="m",
        formerly="pose_noise",
    ),
    Parameter(
        "payload.mass",
        "The end effector takes up a payload of this mass.",
        (0.0, 100.0),
        unit="kg",
        formerly="payload",
    ),
    Parameter(
        "payload.time",
        "The payload is taken up at this time after the start or ~/reset.",
        (0.0, 1.0e6),
        unit="s",
        formerly="payload_time",
    ),
    Parameter(
        "push.force",
        "A push exerts this force on the end effector.",
        size=2,
        unit="N",
        formerly="push",
    ),
    Parameter(
        "push.time",
        "The push begins at this time after the start or ~/reset.",
        (0.0, 1.0e6),
        unit="s",
        formerly="push_time",
    ),
    Parameter(
        "push.duration",
        "The push lasts this long.",
        (0.0, 100.0),
        unit="s",
        formerly="push_duration",
    ),
)

TRAJECTORY_SERVER = (
    Parameter(
        "autostart",
        "The server serves the trip once it is planned and an active controller holds"
        " or waits to be enabled.",
    ),
    Parameter(
        "drawing",
        "The server draws each plan to this .png before it runs, autostart's at the"
        " end; an empty name draws none.",
        live=True,
    ),
    Parameter(
        "task.start",
        "The trip begins at this end effector position A, where the robot is taken to"
        " stand until it is heard.",
        size=2,
        unit="m",
        live=True,
    ),
    Parameter(
        "task.goal",
        "The trip A -> B -> A turns round at this end effector position B.",
        size=2,
        unit="m",
        live=True,
    ),
    Parameter(
        "task.point",
        "A return trip through this point of the locus replaces the trip A -> B -> A;"
        " [] plans none.",
        size=2,
        unit="m",
        live=True,
        formerly="point",
    ),
    Parameter(
        "task.direction",
        "A return trip has this sign of s behind its point; 0 leads away from the side"
        " of A.",
        (-1, 1),
        live=True,
        formerly="direction",
    ),
    Parameter(
        "task.tour",
        "A tour of this many crossings spread over the locus replaces the trip, the"
        " other way round if negative; 0 plans none.",
        (-1000, 1000),
        live=True,
        formerly="tour",
    ),
    Parameter(
        "task.tour_points",
        "A tour through these points of the locus, x, y, x, y, ..., replaces the trip;"
        " [] plans none.",
        unit="m",
        live=True,
        formerly="tour_points",
    ),
    Parameter(
        "task.tour_seed",
        "This seed of the random numbers decides where a tour's crossings are spread.",
        (0, 2**31 - 1),
        live=True,
        formerly="tour_seed",
    ),
    Parameter(
        "task.excite",
        "A motion that lasts about this long, to tell masses and friction (dextar"
        " identify), replaces the trip; 0 plans none.",
        (0.0, 300.0),
        unit="s",
        live=True,
        formerly="excite",
    ),
    Parameter(
        "task.duration",
        "One way of the trip lasts this long; 0 lets the planner choose.",
        (0.0, 60.0),
        unit="s",
        live=True,
        formerly="duration",
    ),
    Parameter(
        "task.dwell",
        "The robot rests this long before, between and after the motions of a plan.",
        (0.01, 60.0),
        unit="s",
        live=True,
        formerly="dwell",
    ),
    Parameter(
        "task.repeat",
        "The plan repeats its return trip, or the laps of its tour, this often.",
        (1, 1000),
        live=True,
        formerly="repeat",
    ),
    Parameter(
        "task.locus_time",
        "This time near the locus costs the planner as much as a peak torque of 0.3 of"
        " the limit; a larger one yields less torque.",
        (5e-3, 5.0),
        unit="s",
        live=True,
        formerly="locus_time",
    ),
    Parameter(
        "task.criterion",
        "The planned motion satisfies this criterion at each crossing; the law"
        " multi_model needs zero_wrench.",
        choices=("reciprocal", "zero_wrench"),
        live=True,
        formerly="criterion",
    ),
    Parameter(
        "task.approach_speed",
        "The robot moves to the start of the trip with at most this speed.",
        (1e-3, 2.0),
        unit="m/s",
        live=True,
        formerly="approach_speed",
    ),
    Parameter(
        "trajectory.sample_period",
        "The points of a served trajectory are this far apart in time, and farther"
        " apart in a very long one.",
        (1e-4, 0.02),
        unit="s",
        live=True,
        formerly="sample_period",
    ),
)

RECORDER = (
    Parameter(
        "output",
        "The recording is written to this .mcap file, whose folder becomes the bag;"
        " {stamp} is its start in UTC.",
    ),
    Parameter(
        "record_from_start",
        "The recorder begins a bag at its start; if false, it waits for ~/start.",
    ),
    Parameter(
        "run.name",
        "The bag keeps this name of the run.",
        live=True,
        formerly="name",
    ),
    Parameter(
        "run.notes",
        "The bag keeps these notes on the run.",
        live=True,
        formerly="notes",
    ),
    Parameter(
        "run.tags",
        "The bag keeps these tags of the run, which are separated by spaces.",
        live=True,
        formerly="tags",
    ),
    Parameter(
        "bag.max_size",
        "The recorder begins the next file when one reaches this size; 0 does not"
        " split.",
        (0, None),
        unit="bytes",
        formerly="max_bag_size",
    ),
    Parameter(
        "bag.max_duration",
        "The recorder begins the next file when one lasts this long; 0 does not split.",
        (0.0, None),
        unit="s",
        formerly="max_bag_duration",
    ),
    Parameter(
        "bag.sync_period",
        "The recorder waits for the disk at this interval, which is what a power cut"
        " can cost.",
        (0.1, 3600.0),
        unit="s",
        formerly="sync_period",
    ),
    Parameter(
        "bag.compression",
        "The recorder compresses each chunk of a bag by this method.",
        choices=("zstd", "none"),
        formerly="compression",
    ),
    Parameter(
        "bag.parameters_of",
        "The bag keeps the parameters of these nodes, whose names are separated by"
        " spaces.",
        formerly="parameters_of",
    ),
    Parameter(
        "topics.reliable",
        "The recorder asks the publishers to repeat lost samples; false costs them"
        " less.",
        formerly="reliable",
    ),
    Parameter(
        "topics.extra",
        "The recorder records these further topics too, whose names are separated by"
        " spaces.",
        formerly="extra_topics",
    ),
)

MARKERS = (
    Parameter(
        "enabled",
        "The node draws; if false, it reads nothing and clears the display.",
        live=True,
    ),
    Parameter("rate", "The drawing is renewed at this rate.", (1.0, 60.0), unit="Hz"),
    Parameter(
        "trail",
        "The path of the end effector stays visible for this long.",
        (0.0, 60.0),
        unit="s",
        live=True,
    ),
    Parameter(
        "text",
        "The drawing shows the phase and scalars as text below the robot.",
        live=True,
    ),
)

PANEL = (
    Parameter(
        "host",
        "The page is served at this address (option --host); any but this machine's own"
        " asks for a token, which is printed.",
    ),
    Parameter(
        "port",
        "The page is served at this port (option --port) or the first free one after"
        " it; 0 takes any.",
        (0, 65535),
    ),
    Parameter("rate", "The page is renewed at this rate.", (5.0, 60.0), unit="Hz"),
)

PARAMETERS = {
    "plant": PLANT,
    "controller": CONTROLLER,
    "trajectory_server": TRAJECTORY_SERVER,
    "recorder": RECORDER,
    "markers": MARKERS,
    "panel": PANEL,
}
"""By the node's name."""


def parameters_of_node(node: str) -> tuple[Parameter, ...]:
    """Return those of the node with this name, with or without its namespace; none of
    a node that is not of this package.
    """
    return PARAMETERS.get(node.rpartition("/")[2], ())
