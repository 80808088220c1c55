from dextar_control.core.trajectory import *  # noqa
