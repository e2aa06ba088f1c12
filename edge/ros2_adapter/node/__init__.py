"""The adapter's node, for the robot's own ROS Python: uses rclpy and zenoh, nothing of `edge`.

Messages pass as bytes, from DDS only while they have a receiver on Zenoh. The action's three
services are queryables, as in zenoh-bridge-ros2dds; only their requests and answers are
deserialized, because rclpy needs that.
"""
