"""Node ``monitor``: the ROS shell, its services and messages."""
