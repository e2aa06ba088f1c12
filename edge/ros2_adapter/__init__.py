"""Adapter for any ROS 2 system: passes messages and NavigateToPose between DDS and Zenoh.

A small rclpy node runs in the robot's own Python. `process` starts and supervises the
node; `node` has its code.
"""
