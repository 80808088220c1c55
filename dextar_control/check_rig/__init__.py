"""Whether a rig's driver keeps the contract: recorded samples in, lines of a report
out.

- ``samples``: what was seen; ``report``: what is said about it; ``limits``: what is
  allowed.
- ``stream``: judges the graph and the stream of states, without touching the robot.
- ``torque``: small torques, one ``trial`` after the other; ``response`` judges what the
  robot did under them.
- ``check``: puts them together. None of these needs ROS; ``client`` gets the samples
  from a rig, or sends the torques.
"""
