"""Zenoh sessions, keys with their type and quality of service, wire formats, requests and answers.

This package does not interpret messages: it does not know what they mean to the robot.
"""
