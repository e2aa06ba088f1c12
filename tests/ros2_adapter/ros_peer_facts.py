"""Names that `ros_peer.py` and its tests share; for both Pythons."""

# What becomes of a goal goes by its x.
REACHED, ABORTED, REJECTED, ENDLESS = 1.0, 2.0, 3.0, 4.0
PIXELS = bytes(range(48)) * 4  # of an image of 8x8 rgb8
STAMP_NS = 1_700_000_000_123_456_789  # of each odometry
MOUNTED = 0.1, 0.0, 0.6  # metres from base_link to camera
