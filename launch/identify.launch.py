"""What crossing.launch.py starts, with a motion that tells masses and friction to
dextar identify in place of a trip.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

from dextar_control.experiments.launch_arguments import ARGUMENTS

EXCITE = "20"  # s


def generate_launch_description() -> LaunchDescription:
    """All arguments of crossing.launch.py may be given."""
    crossing = (
        Path(get_package_share_directory("dextar")) / "launch" / "crossing.launch.py"
    )
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "excite", default_value=EXCITE, description=ARGUMENTS["excite"].told
            ),
            IncludeLaunchDescription(PythonLaunchDescriptionSource(str(crossing))),
        ]
    )
