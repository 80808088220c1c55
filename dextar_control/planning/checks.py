from dextar_control.core.certificate import certify, check_rest  # noqa
