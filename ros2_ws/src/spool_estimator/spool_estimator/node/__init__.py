"""Node ``estimator``: the ROS shell, with the model gap's event and its analysis on request."""
