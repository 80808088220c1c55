from dextar_control.core.certificate import *  # noqa
