"""GStreamer's RTSP server with a test picture in H.264, part of which moves; needs `gi`.

Run as `python3 rtsp_server.py PORT WIDTH HEIGHT`; it serves until it is killed.
"""

import sys

import gi

gi.require_version("Gst", "1.0")
gi.require_version("GstRtspServer", "1.0")
from gi.repository import GLib, Gst, GstRtspServer  # noqa: E402

port, width, height = sys.argv[1:]
Gst.init(None)
if Gst.ElementFactory.find("x264enc") is None:
    sys.exit("no x264enc: install gstreamer1.0-plugins-ugly")
factory = GstRtspServer.RTSPMediaFactory()
factory.set_launch(
    f"( videotestsrc is-live=true pattern=smpte ! video/x-raw,width={width},height={height},"
    "framerate=15/1 ! x264enc tune=zerolatency speed-preset=ultrafast key-int-max=15 "
    "! rtph264pay name=pay0 pt=96 )"
)
factory.set_shared(True)
server = GstRtspServer.RTSPServer(address="127.0.0.1", service=port)
server.get_mount_points().add_factory("/stream", factory)
if not server.attach(None):
    sys.exit(f"port {port} is not free")
print("serves", flush=True)
GLib.MainLoop().run()
