"""The panel in the browser is one page, and the server that lets it watch and drive. No
ROS here.
"""
