"""ROS for posefuse: messages, nodes without a ROS installation, MCAP recordings, sessions on several machines."""
