"""Beside any ROS 2: a small rclpy node in the robot's own Python that passes messages between DDS
and Zenoh unopened, and goals to Nav2's action. `process` prepares and watches it, `node` is it.
"""
