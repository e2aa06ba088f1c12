"""The operating system: processes, signals, threads, files, ports, HTTP, systemd.

Nothing here depends on robots.
"""
