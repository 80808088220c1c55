"""One DDS domain for each test process."""

import os

from dextar_control.nodekit.domain import own_domain

os.environ["ROS_DOMAIN_ID"] = str(own_domain())
