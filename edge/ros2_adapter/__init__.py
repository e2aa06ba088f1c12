"""Beside any ROS 2: a small rclpy node in the robot's own Python that passes messages, and the
action NavigateToPose, between DDS and Zenoh. `process` prepares and watches it, `node` is it.
"""
