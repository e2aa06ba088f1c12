"""Names that `ros_peer.py` and its tests share; for both Pythons."""

# The x of a goal decides its outcome.
REACHED, ABORTED, REJECTED, ENDLESS = 1.0, 2.0, 3.0, 4.0
PIXELS = bytes(range(48)) * 4  # an image of 8x8 rgb8
STAMP_NS = 1_700_000_000_123_456_789  # each odometry
MOUNTED = 0.1, 0.0, 0.6  # metres from base_link to camera
