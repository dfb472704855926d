"""Accelerometers with a ROS driver as sources of the suite."""
