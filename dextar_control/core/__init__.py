"""The mathematical core: NumPy (compiled by numba), no ROS, no simulator."""
