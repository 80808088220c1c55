from dextar_control.core.trajectory import *  # noqa
from dextar_control.core.trajectory import Trajectory, hold
