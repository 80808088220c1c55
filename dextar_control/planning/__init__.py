"""Planning: trajectories, what they ask of the robot, and the search for those that
cross the Type 2 locus.
"""
