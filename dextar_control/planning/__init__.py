"""Trajectories, their certificates, and the search for those that cross the Type 2
locus.
"""
