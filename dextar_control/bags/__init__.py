"""Bags, whole or damaged: written, scanned, read into columns, recovered, and described
as rosbag2 does. Needs no ROS.
"""
