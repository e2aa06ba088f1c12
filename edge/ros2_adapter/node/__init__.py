"""What runs in the robot's own ROS Python: rclpy and zenoh, nothing of `edge`.

Messages are passed as the bytes that they are, from DDS only while somebody hears them on Zenoh.
The action's three services are queryables there, as zenoh-bridge-ros2dds has them; only their
requests and answers are opened, as rclpy wants it.
"""
