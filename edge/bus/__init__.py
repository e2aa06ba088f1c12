"""The bus: Zenoh sessions, every key with its type and quality of service, what lies on the wire,
and requests with their answers. What a message means to the robot is nobody's business here.
"""
