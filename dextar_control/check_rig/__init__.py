"""The check tells whether a rig's driver keeps the contract: recorded samples come in,
lines of a report go out.

- ``samples`` holds what was seen, ``report`` what is said about it, ``limits`` what is
  allowed.
- ``stream`` judges the graph and the stream of states, without touching the robot.
- ``torque`` sends small torques, one ``trial`` after the other; ``response`` judges
  what the robot did under them.
- ``check`` puts them together. None of these needs ROS; ``client`` gets the samples
  from a rig, or sends the torques.
"""
