"""What the service needs of the computer it runs on: processes, signals, threads, folders, ports.

Nothing here knows of robots.
"""
